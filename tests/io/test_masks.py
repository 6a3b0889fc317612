"""Masks: pixels that are no equations, from images and polygons, in the files' orientation."""

import imagecodecs
import numpy as np
import pytest
import tifffile

from plenopiv.errors import PlenoPIVError
from plenopiv.recording import Recording
from plenopiv.recording.masks import mask_of_image, mask_of_polygons
from plenopiv.sensor import Sensor

SENSOR = Sensor(40, 30, 0.0055, 12, 60.0)
SHAPE = SENSOR.rows, SENSOR.columns


def frames(folder, lit=None):
    """Two frames whose pixels (row, column) ``lit``, as they are stored, are the only bright ones."""
    counts = np.full(SHAPE, 60, np.uint16)
    counts[lit or (0, 0)] = 900
    for name in "ab":
        tifffile.imwrite(folder / f"{name}.tif", counts)
    return folder / "a.tif", folder / "b.tif"


def written(folder, name, values):
    """A mask image in one of the formats that are read."""
    path = folder / name
    if path.suffix == ".png":
        path.write_bytes(imagecodecs.png_encode(values))
    elif path.suffix == ".npy":
        np.save(path, values)
    else:
        tifffile.imwrite(path, values)
    return path


@pytest.mark.parametrize("name", ["mask.png", "mask.tif", "mask.npy"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_zero_is_masked_in_every_format_and_depth(tmp_path, name, kind):
    values = np.full(SHAPE, np.iinfo(kind).max, kind)
    values[3, 5] = 0
    values[20, 30] = 1
    masked = mask_of_image(written(tmp_path, name, values), SENSOR)
    assert np.argwhere(masked).tolist() == [[3, 5]]


@pytest.mark.parametrize("orientation", ["upright", "sensor"])
@pytest.mark.parametrize("corner", [(2, 3), (2, 36), (27, 3), (27, 36)])
@pytest.mark.parametrize("form", ["image", "polygons"])
def test_a_mask_lies_where_the_frames_stored_pixels_do(tmp_path, orientation, corner, form):
    """Light in one corner of the stored frame, and a mask in the same corner of the stored mask: upright both are in
    one place, the opposite corner of an image stored as the sensor has it."""
    row, column = corner
    paths = frames(tmp_path, corner)
    values = np.full(SHAPE, 255, np.uint8)
    values[row, column] = 0
    r, c = row - 0.5, column - 0.5
    square = (((c, r), (c + 1, r), (c + 1, r + 1), (c, r + 1)),)
    mask = written(tmp_path, "mask.png", values) if form == "image" else square
    recording = Recording(SENSOR, paths, None, 1e-3, orientation, mask=mask)
    np.testing.assert_array_equal(recording.masked, recording.frame(0) == 900)
    turned = [SENSOR.rows - 1 - row, SENSOR.columns - 1 - column]
    assert np.argwhere(recording.masked).tolist() == [[row, column] if orientation == "upright" else turned]


def inside(corners, row, column):
    """Even-odd rule for one point, as a loop over edges; None on an edge."""
    odd = False
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        cross = (x1 - x0) * (row - y0) - (y1 - y0) * (column - x0)
        length = max(abs(x1 - x0), abs(y1 - y0))
        if abs(cross) < 1e-7 * length and min(x0, x1) <= column <= max(x0, x1) and min(y0, y1) <= row <= max(y0, y1):
            return None
        if (y0 > row) != (y1 > row) and column < x0 + (row - y0) / (y1 - y0) * (x1 - x0):
            odd = not odd
    return odd


@pytest.mark.parametrize("seed", range(12))
def test_polygons_are_the_pixels_whose_centres_they_hold(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform((-8, -8), (48, 38), (rng.integers(3, 9), 2))
    if seed % 2:  # corners on pixel centres, some rows and columns shared
        corners = np.rint(corners / 4) * 4
    masked = mask_of_polygons([corners.tolist()], SENSOR)
    for row, column in np.ndindex(SHAPE):
        expected = inside(corners.tolist(), row, column)
        assert masked[row, column] == (expected is None or expected), (row, column)


def test_several_polygons_add_up_and_borders_belong_to_them():
    square = [(2, 3), (5, 3), (5, 6), (2, 6)]
    masked = mask_of_polygons([square, [(30, 20), (39, 20), (39, 29)]], SENSOR)
    assert masked[3:7, 2:6].all()
    assert masked[:10, :10].sum() == 16
    assert masked[29, 39]
    assert not masked[29, 30]


def test_pixels_that_are_masked_or_hot_are_no_equations(tmp_path):
    dark = np.full(SHAPE, 60, np.uint16)
    dark[::7, ::3] += 1
    dark[4, 4] = 2000
    tifffile.imwrite(tmp_path / "dark.tif", dark)
    square = (((10, 10), (12, 10), (12, 12), (10, 12)),)
    paths, dark_path = frames(tmp_path), tmp_path / "dark.tif"
    both = Recording(SENSOR, paths, None, 1e-3, "upright", dark_path=dark_path, mask=square)
    assert both.unusable[4, 4]
    assert both.unusable[10:13, 10:13].all()
    assert both.unusable.sum() == 10
    assert Recording(SENSOR, paths, None, 1e-3, "upright", mask=square).unusable.sum() == 9
    assert Recording(SENSOR, paths, None, 1e-3, "upright", dark_path=dark_path).unusable.sum() == 1
    assert Recording(SENSOR, paths, None, 1e-3, "upright").unusable is None


def test_masks_that_cannot_be(tmp_path):
    paths = frames(tmp_path)

    def complaint(mask):
        with pytest.raises(PlenoPIVError) as caught:
            Recording(SENSOR, paths, None, 1e-3, "sensor", mask=mask)
        message = str(caught.value)
        assert "\n" not in message
        return message

    ones = np.full(SHAPE, 255, np.uint8)
    assert "masks no pixel; 0 is masked" in complaint(written(tmp_path, "open.png", ones))
    assert "masks every pixel" in complaint(written(tmp_path, "shut.png", 0 * ones))
    small = complaint(written(tmp_path, "small.png", ones[:-1]))
    assert "small.png" in small
    assert "40 x 29" in small
    assert "40 x 30" in small
    assert "no such file" in complaint(tmp_path / "none.png")
    assert "colour" in complaint(written(tmp_path, "colour.png", np.stack([ones] * 3, -1)))
    assert "recording.mask[1]" in complaint((((1, 1), (5, 1), (5, 5)), ((50, 1), (60, 1), (60, 9))))
    assert "recording.mask[0]" in complaint((((1.2, 1.2), (1.4, 1.2), (1.4, 1.4)),))
    assert "masks every pixel" in complaint((((-1, -1), (50, -1), (50, 50), (-1, 50)),))


def test_saturated_pixels_that_are_masked_are_not_warned_about(tmp_path, recwarn):
    paths = frames(tmp_path)
    counts = tifffile.imread(paths[0])
    counts[5:9, 5:9] = SENSOR.full_scale
    tifffile.imwrite(paths[0], counts)
    square = (((5, 5), (8, 5), (8, 8), (5, 8)),)
    Recording(SENSOR, paths, None, 1e-3, "upright", mask=square).frame(0)
    assert not recwarn.list
    with pytest.warns(UserWarning, match="saturated"):
        Recording(SENSOR, paths, None, 1e-3, "upright").frame(0)
