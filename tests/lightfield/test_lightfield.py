"""Raw pixels to views: which pixel belongs to which lens, and how much of it the aperture's image lights."""

from dataclasses import replace

import numpy as np
import pytest
import xarray
from oracles.cameras import small_camera
from oracles.light import disc_rectangle_area

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import decode, disc_share, encode, layout
from plenopiv.simulation.white import white_image

CAMERAS = {
    "square-8": small_camera("square", pmr=8, offset_mm=(0.009, -0.004), black_level=60.0),
    "square-14": small_camera("square", rotation_rad=0.002, black_level=60.0),
    "square-14.04": small_camera("square", pmr=14.04, offset_mm=(0.03, 0.01)),
    "hexagonal-8": small_camera("hexagonal", pmr=8, rotation_rad=-0.01),
    "hexagonal-14.04": small_camera("hexagonal", pmr=14.04, rotation_rad=0.017, offset_mm=(0.01, 0.02)),
    "hexagonal-overlapping": small_camera("hexagonal", rotation_rad=0.01, offset_mm=(0.01, 0.02), aperture=1.1),
}
LAYOUTS = {name: layout(camera) for name, camera in CAMERAS.items()}
every_layout = pytest.mark.parametrize("where", LAYOUTS.values(), ids=LAYOUTS)


@every_layout
def test_decode_and_encode_keep_every_seen_pixel(where):
    sensor = where.camera.sensor
    image = np.random.default_rng(0).integers(0, 4096, (sensor.rows, sensor.columns)).astype(np.uint16)
    values = decode(image, where).values
    assert values.dtype == np.float32
    assert not values[~where.seen].any()
    back = encode(values, where)
    ours = encode(where.seen.astype(np.float32), where) > 0
    np.testing.assert_array_equal(back[ours] + sensor.black_level, image[ours])
    assert not back[~ours].any()
    np.testing.assert_array_equal(decode(back + sensor.black_level, where).values, values)


@every_layout
def test_a_pixel_belongs_to_at_most_one_lens(where):
    view, lens = np.nonzero(where.seen)
    pixels = where.pixel[lens] + where.offsets[view]
    assert len(np.unique(pixels, axis=0)) == len(pixels)
    # and to the nearest one: none of its neighbours' images comes closer
    s, t = where.camera.sensor.plane_from_pixel(*pixels.T)
    e = where.camera.image_scale
    i, j = where.camera.lattice.nearest(s / (1 + e), t / (1 + e))
    np.testing.assert_array_equal((j - where.j0) * where.ni + (i - where.i0), lens)


@every_layout
def test_views_and_phases_are_where_the_micro_images_are(where):
    """The pixel nearest to S (1 + e), and what it misses the centre by; columns grow with -s, rows with +t."""
    camera, e = where.camera, where.camera.image_scale
    p = camera.sensor.pixel_pitch_mm
    for lens in (0, where.lenses // 2, where.lenses - 1):
        s, t = camera.lattice.centres(where.i0 + lens % where.ni, where.j0 + lens // where.ni)
        column, row = where.pixel[lens] + where.phase[lens]
        assert camera.sensor.axis[0] - column == pytest.approx(s * (1 + e) / p, abs=1e-4)
        assert row - camera.sensor.axis[1] == pytest.approx(t * (1 + e) / p, abs=1e-4)
    assert np.abs(where.phase).max() <= 0.5 + 1e-6


def test_most_pixels_of_the_sensor_are_equations():
    """Square cells: a disc covers pi/4 of its cell; about a tenth is lost to pixels that hold less than half of it."""
    where = LAYOUTS["square-14"]
    share = where.seen.sum() / (where.camera.sensor.rows * where.camera.sensor.columns)
    assert 0.68 < share < np.pi / 4 + 0.02


@every_layout
def test_fill_is_the_area_of_the_pixel_in_the_disc(where):
    radius = where.camera.aperture_radius_px
    rng = np.random.default_rng(1)
    for view, lens in zip(rng.integers(0, where.views, 300), rng.integers(0, where.lenses, 300), strict=True):
        x, y = where.offsets[view] - where.phase[lens]
        want = disc_rectangle_area(x - 0.5, x + 0.5, y - 0.5, y + 0.5, radius)
        assert where.fill[view, lens] == pytest.approx(want, abs=2e-3)


def test_disc_share_far_and_near():
    assert disc_share(np.array([0.0, 6.0, 8.0]), np.array([0.0, 0.0, 0.0]), 7.0).tolist() == [1.0, 1.0, 0.0]
    x, y = np.random.default_rng(2).uniform(-8, 8, (2, 500))
    np.testing.assert_array_equal(disc_share(x, y, 7.0), disc_share(-y, x, 7.0))


@every_layout
def test_white_image_over_fill_is_uniform(where):
    """Simulated independently; a pixel's light is its own lens', to a part in a thousand."""
    camera = where.camera
    white = white_image(camera, 1000.0) + camera.sensor.black_level
    even = decode(white, where).values[where.seen] / where.fill[where.seen] / 1000.0
    assert np.median(even) == pytest.approx(1.0, abs=1e-3)
    assert even.min() > 1 - 1e-3
    assert even.max() < 1 + 1e-3


@every_layout
def test_no_equation_holds_the_light_of_a_neighbour_s_micro_image(where):
    """In even light, a pixel's counts beyond what its own lens sends there, of those of a pixel wholly lit: at full
    scale (4095 counts) they stay below the read noise (two counts). Micro-images of matched and of too wide apertures,
    which overlap."""
    camera = where.camera
    even = decode(white_image(camera, 1.0) + camera.sensor.black_level, where).values.astype(float)
    assert (even - where.fill)[where.seen].max() < 5e-4


@every_layout
def test_an_aperture_known_to_a_percent_tells_the_light_of_every_equation(where):
    """The rim of a micro-image moves by r/100, across up to 1.41 px of a pixel: a pixel of which it leaves half is off
    by a fifth at most. One of which it leaves a fifth would be by a third and more, and teach MART nothing."""
    camera = where.camera
    lens = camera.main_lens
    wider = replace(camera, main_lens=replace(lens, aperture_mm=1.01 * lens.aperture_mm))
    light = decode(white_image(wider, 1.0) + camera.sensor.black_level, where).values.astype(float)
    off = np.abs(light[where.seen] / where.fill[where.seen] - 1.0)
    assert off.max() < 0.25
    assert np.sqrt(np.mean(off**2)) < 0.06


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_pixel_that_is_no_number_is_refused_unless_it_is_masked(value):
    camera = CAMERAS["square-14"]
    where, image = LAYOUTS["square-14"], np.full((camera.sensor.rows, camera.sensor.columns), 100.0)
    column, row = where.pixel[where.lenses // 2] + where.offsets[where.views // 2]
    image[row, column] = value
    with pytest.raises(PlenoPIVError, match=rf"the pixel at column {column}, row {row} is {value}, .*\(unusable="):
        decode(image, where)
    masked = layout(camera, ~np.isfinite(image))
    assert decode(image, masked).values.max() == 40.0


def test_a_frame_may_be_a_list_or_of_xarray():
    where, sensor = LAYOUTS["square-14"], CAMERAS["square-14"].sensor
    image = np.random.default_rng(0).integers(0, 4000, (sensor.rows, sensor.columns)).astype(np.uint16)
    expected = decode(image, where).values
    for same in (xarray.DataArray(image, dims=("y", "x")), image.tolist(), np.ma.masked_array(image)):
        np.testing.assert_array_equal(decode(same, where).values, expected)


def test_a_masked_array_that_hides_pixels_is_refused():
    where = LAYOUTS["square-14"]
    image = np.ma.zeros((where.camera.sensor.rows, where.camera.sensor.columns))
    image[10, 10] = np.ma.masked
    with pytest.raises(PlenoPIVError, match=r"hides pixels; leave them out with Chain\(unusable=mask\)"):
        decode(image, where)


def test_the_brightest_finite_pixels_are_taken():
    """Their sum is beyond float32."""
    where = LAYOUTS["square-14"]
    image = np.full((where.camera.sensor.rows, where.camera.sensor.columns), np.finfo(np.float32).max)
    assert np.isfinite(decode(image, where).values).all()


def test_images_and_masks_of_another_size_are_refused():
    camera, where = CAMERAS["square-14"], LAYOUTS["square-14"]
    rows, columns = camera.sensor.rows, camera.sensor.columns
    wanted = f"px; give {columns} x {rows} px, as the camera's sensor has"
    for shape in ((rows + 2, columns + 2), (rows - 2, columns), (columns, rows)):
        with pytest.raises(PlenoPIVError, match=f"frame: {shape[1]} x {shape[0]} {wanted}"):
            decode(np.zeros(shape), where)
        with pytest.raises(PlenoPIVError, match=f"unusable: {shape[1]} x {shape[0]} {wanted}"):
            layout(camera, np.zeros(shape, bool))


def test_a_mask_that_leaves_no_pixel_is_refused():
    camera = CAMERAS["square-14"]
    with pytest.raises(PlenoPIVError, match="unusable: no pixel that shows a microlens is left; leave out fewer"):
        layout(camera, np.ones((camera.sensor.rows, camera.sensor.columns), bool))
