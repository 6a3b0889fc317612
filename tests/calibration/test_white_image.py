"""The lattice from white images: against known lattices, signs, errors, and an independent recording."""

import json
import warnings
from math import pi

import numpy as np
import pytest
from white_images import PIXEL_MM, E, camera_for, true_centres, white_image, worst_error_px

from plenopiv.calibration import find_lattice
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import simulate_recording

# each condition on one lattice; on the other in the full set
hexagons = pytest.mark.parametrize("kind", ["hexagonal", pytest.param("square", marks=pytest.mark.full)])
squares = pytest.mark.parametrize("kind", [pytest.param("hexagonal", marks=pytest.mark.full), "square"])


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error", PlenoPIVWarning)
        yield


@hexagons
@pytest.mark.parametrize(
    ("shape", "pitch_px", "rotation_deg"),
    [
        ((400, 520), 8.024, 0.1),
        pytest.param((400, 520), 8.024, 12.0, marks=pytest.mark.full),
        pytest.param((400, 520), 14.04, 0.0, marks=pytest.mark.full),
        pytest.param((400, 520), 14.04, 0.1, marks=pytest.mark.full),
        pytest.param((400, 520), 14.04, 1.0, marks=pytest.mark.full),
        pytest.param((400, 520), 14.04, -29.0, marks=pytest.mark.full),
        pytest.param((600, 500), 28.09, 1.0, marks=pytest.mark.full),
    ],
)
def test_centres_over_the_whole_sensor(kind, shape, pitch_px, rotation_deg):
    offset = (0.37 * pitch_px, -0.21 * pitch_px)
    white = white_image(shape, kind, pitch_px, rotation_deg, offset)
    camera = camera_for(shape, kind, 1.008 * pitch_px)  # stated 0.8 % off
    fit = find_lattice(white, camera)
    assert worst_error_px(fit, camera, true_centres(shape, kind, pitch_px, rotation_deg, offset)) < 0.015
    assert fit.image_pitch_px == pytest.approx(pitch_px, rel=5e-5)
    assert fit.lattice.pitch_mm == pytest.approx(pitch_px * PIXEL_MM / (1.0 + E), rel=5e-5)  # microlenses, not images
    assert fit.rotation_deg == pytest.approx(rotation_deg, abs=0.005)
    assert fit.residual_px < 0.03
    assert fit.worst_region_px < 0.02
    assert abs(fit.stretch) < 2e-4
    assert abs(fit.shear_rad) < 2e-4
    assert fit.microlenses > 0.6 * shape[0] * shape[1] / (fit.lattice.row_spacing * pitch_px**2)


@squares
@pytest.mark.full
@pytest.mark.parametrize("pitch_px", [8.0, 28.0])
def test_every_lens_at_the_same_sub_pixel_position(kind, pitch_px):
    """A pitch of whole pixels without rotation: what a fit's bias depends on does not average out."""
    shape, offset = (400, 500), (1.3, -2.6)
    camera = camera_for(shape, kind, pitch_px)
    fit = find_lattice(white_image(shape, kind, pitch_px, 0.0, offset), camera)
    assert worst_error_px(fit, camera, true_centres(shape, kind, pitch_px, 0.0, offset)) < 0.05


@squares
@pytest.mark.parametrize(
    "light",
    [
        {"fill": 0.6},
        pytest.param({"fill": 0.95}, marks=pytest.mark.full),
        pytest.param({"fill": 0.97}, marks=pytest.mark.full),
        pytest.param({"fill": 0.98}, marks=pytest.mark.full),
        pytest.param({"fill": 1.03}, marks=pytest.mark.full),
        pytest.param({"fill": 1.08, "electrons": 1500.0}, marks=pytest.mark.full),
        pytest.param({"electrons": 60.0}, marks=pytest.mark.full),
        pytest.param({"falloff": 0.85}, marks=pytest.mark.full),
        pytest.param({"dust": 0.1}, marks=pytest.mark.full),
    ],
)
def test_other_apertures_and_poor_light(kind, light):
    shape, offset = (380, 460), (-3.1, 4.4)
    # The stated aperture is wrong as well: the discs are measured, not believed.
    camera = camera_for(shape, kind, 14.04, aperture_mm=14.3)
    fit = find_lattice(white_image(shape, kind, 14.04, 3.0, offset, **light), camera)
    assert worst_error_px(fit, camera, true_centres(shape, kind, 14.04, 3.0, offset)) < 0.03


@hexagons
def test_offset_and_rotation_have_the_sign_of_the_frame(kind):
    """Columns grow with -s and rows with +t; rotation is counter-clockwise from s to t."""
    shape, mm = (201, 261), PIXEL_MM / (1.0 + E)
    camera = camera_for(shape, kind, 14.0)
    for offset in ((3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)):
        fit = find_lattice(white_image(shape, kind, 14.0, 0.0, offset), camera)
        assert np.array(fit.offset_mm) / mm == pytest.approx(offset, abs=0.03)
    white = white_image(shape, kind, 14.0, 0.0, (3.0, 0.0), dust=0.0, falloff=0.0)
    # A disc centred 3 px to the left of the axis (130, 100), 14 px wide.
    assert white[100, 121:134].min() > 2000
    for rotation_deg in (2.0, -2.0):
        fit = find_lattice(white_image(shape, kind, 14.0, rotation_deg), camera)
        assert fit.rotation_deg == pytest.approx(rotation_deg, abs=0.01)
        # Along s micro-images go to the left, and for a positive rotation down in the image.
        s, t = fit.lattice.centres(6, 0)
        column, row = camera.sensor.pixel_from_plane(s * (1.0 + E), t * (1.0 + E))
        assert column == pytest.approx(130 - 84, abs=0.5)
        assert (row - 100) * rotation_deg > 2.0


@pytest.mark.parametrize(("kind", "rotation_deg", "reduced_deg"), [
    ("hexagonal", 40.0, -20.0), pytest.param("hexagonal", 75.0, 15.0, marks=pytest.mark.full),
    pytest.param("square", 60.0, -30.0, marks=pytest.mark.full), ("square", -50.0, 40.0),
])  # fmt: skip
def test_rotation_and_offset_are_reduced(kind, rotation_deg, reduced_deg):
    shape, offset = (300, 360), (37.0, -50.0)
    camera = camera_for(shape, kind, 14.04)
    fit = find_lattice(white_image(shape, kind, 14.04, rotation_deg, offset), camera)
    assert fit.rotation_deg == pytest.approx(reduced_deg, abs=0.01)
    assert np.hypot(*fit.offset_mm) <= fit.lattice.pitch_mm / 2**0.5
    assert fit.lattice.nearest(0.0, 0.0) == (0, 0)


@pytest.mark.full
@hexagons
def test_rows_along_t(kind):
    """A hexagonal lattice with its rows along t is one turned by 30 degrees, of either sign."""
    shape, offset = (300, 360), (2.0, 1.0)
    camera = camera_for(shape, kind, 14.04)
    fit = find_lattice(white_image(shape, kind, 14.04, 90.0, offset), camera)
    assert worst_error_px(fit, camera, true_centres(shape, kind, 14.04, 90.0, offset)) < 0.02
    assert abs(fit.rotation_deg) == pytest.approx(30.0 if kind == "hexagonal" else 0.0, abs=0.01)


@pytest.mark.full
def test_stretched_array():
    """Spacing along s stretched by 0.2 %: an affine map, the pitch along the rows, nothing left in the residuals."""
    shape = (500, 500)
    s, t = true_centres((520, 520), "hexagonal", 14.04, 0.0, (0.0, 0.0))
    white = white_image(shape, "hexagonal", 14.04, centres=(1.002 * s, t))
    camera = camera_for(shape, "hexagonal", 14.04)
    fit = find_lattice(white, camera, "white.tif")
    assert fit.lattice.map.degree == 1
    assert fit.stretch == pytest.approx(0.002, rel=0.02)
    assert fit.shear_rad == pytest.approx(0.0, abs=5e-5)
    assert abs(fit.stretch - 0.002) < 4 * fit.stretch_std < 2e-4
    assert abs(fit.shear_rad) < 4 * fit.shear_std_rad < 2e-4
    assert fit.image_pitch_px == pytest.approx(1.002 * 14.04, rel=2e-5)
    assert fit.worst_region_px < 0.02
    assert worst_error_px(fit, camera, (1.002 * s, t)) < 0.02


@hexagons
@pytest.mark.full
def test_sheared_array(kind):
    """Columns lean by 0.8 mrad; the rotation is that of the rows, which are turned by -2 degrees."""
    shape, turn = (400, 400), np.radians(-2.0)
    s, t = true_centres((420, 420), kind, 14.04, -2.0, (0.0, 0.0))
    along, across = np.cos(turn) * s + np.sin(turn) * t, np.cos(turn) * t - np.sin(turn) * s
    s = np.cos(turn) * (along + 0.0008 * across) - np.sin(turn) * across
    t = np.sin(turn) * (along + 0.0008 * across) + np.cos(turn) * across
    camera = camera_for(shape, kind, 14.04)
    fit = find_lattice(white_image(shape, kind, 14.04, centres=(s, t)), camera)
    assert fit.shear_rad == pytest.approx(0.0008, rel=0.05)
    assert fit.rotation_deg == pytest.approx(-2.0, abs=0.002)
    assert abs(fit.rotation_deg + 2.0) < 4 * np.degrees(fit.rotation_std_rad) < 0.01
    assert worst_error_px(fit, camera, (s, t)) < 0.02


@squares
@pytest.mark.full
@pytest.mark.parametrize(
    ("degree", "of"),
    [
        (2, lambda u: 2.0 * u.real**2 - 1j * u.real * u.imag),
        (3, lambda u: 1.5 * u * np.abs(u) ** 2),
        (3, lambda u: -2.0 * u * np.abs(u) ** 2),
    ],
)
def test_distorted_array(kind, degree, of):
    """Quadratic and cubic departures of up to 2 px in the corners, which a lattice of the same map follows."""
    shape = (460, 540)
    s, t = true_centres((480, 560), kind, 11.3, 1.0, (2.0, -3.0))
    moved = (s + 1j * t) + of((s + 1j * t) / np.hypot(230, 270))
    centres = moved.real, moved.imag
    camera = camera_for(shape, kind, 11.3)
    fit = find_lattice(white_image(shape, kind, 11.3, centres=centres), camera)
    assert fit.lattice.map.degree == degree
    assert worst_error_px(fit, camera, centres) < 0.04


@pytest.mark.full
def test_rows_of_residual_map_are_rows_of_the_upright_image():
    """A corner of the array, top right, moved by 0.7 px: its block alone stands out."""
    shape = (450, 600)
    s, t = true_centres(shape, "hexagonal", 14.04, 0.0, (0.0, 0.0))
    moved = (s < -150) & (t < -112)  # columns grow with -s, rows with t
    with pytest.warns(PlenoPIVWarning, match=r"region \(row 1, column 4\)"):
        fit = find_lattice(
            white_image(shape, "hexagonal", 14.04, centres=(s + 0.7 * moved, t)), camera_for(shape, "hexagonal", 14.04)
        )
    assert np.unravel_index(np.argmax(fit.residual_map_px), (4, 4)) == (0, 3)


@pytest.mark.parametrize(
    ("image", "reason"), [("flat", "not white"), ("dark", "too dim"), ("noise", "not white"), ("stripes", "not white")]
)
def test_no_lattice(image, reason):
    shape = (300, 400)
    rng = np.random.default_rng(1)
    stripes = 1000.0 + 500.0 * np.cos(2 * pi * np.arange(400) / 14.04)
    white = {
        "flat": np.full(shape, 1000.0), "dark": rng.normal(60.0, 3.0, shape), "noise": rng.poisson(1000.0, shape),
        "stripes": np.broadcast_to(stripes, shape) + rng.normal(0.0, 5.0, shape),
    }[image]  # fmt: skip
    with pytest.raises(PlenoPIVError, match=rf"w\.tif: {reason}: no microlens lattice of about 14\.04 px found"):
        find_lattice(white, camera_for(shape, "hexagonal", 14.04), "w.tif")


@pytest.mark.parametrize(("kind", "stated"), [("hexagonal", "square"), ("square", "hexagonal")])
def test_wrong_kind(kind, stated):
    white = white_image((300, 400), kind, 14.04, 5.0)
    with pytest.raises(PlenoPIVError, match=f'shows a {kind} lattice .* states "{stated}": set it to "{kind}"'):
        find_lattice(white, camera_for((300, 400), stated, 14.04))


@hexagons
@pytest.mark.parametrize("factor", [0.52, 0.95, 1.04, 2.0])
def test_wrong_pitch(kind, factor):
    white = white_image((300, 400), kind, 14.04, 5.0)
    camera = camera_for((300, 400), kind, factor * 14.04)
    with pytest.raises(
        PlenoPIVError, match=rf"microlenses 76\.9\d um \(14\.0\d+ px\) apart, .* \({factor * 14.04:.3f} p"
    ):
        find_lattice(white, camera)


def test_wrong_size():
    with pytest.raises(PlenoPIVError, match=r"w\.tif: 400 x 300 px .* states 300 x 400"):
        find_lattice(np.zeros((300, 400)), camera_for((400, 300), "square", 14.0), "w.tif")


def test_not_finite():
    with pytest.raises(PlenoPIVError, match=r"w\.tif: holds NaN"):
        find_lattice(np.full((300, 400), np.nan), camera_for((300, 400), "square", 14.0), "w.tif")


def test_too_few_microlenses():
    with pytest.raises(PlenoPIVError, match=r"too few|no microlens lattice"):
        find_lattice(white_image((70, 70), "square", 14.0), camera_for((70, 70), "square", 14.0))


@pytest.mark.full
def test_saturation():
    white = white_image((300, 400), "hexagonal", 14.04, electrons=4300.0, dust=0.0)
    share = np.mean(white == 4095)
    with pytest.warns(PlenoPIVWarning, match=f"w.tif: {share:.1%} of the pixels are saturated"):
        find_lattice(white, camera_for((300, 400), "hexagonal", 14.04), "w.tif")


def test_speckle_is_no_white_image():
    white = white_image((300, 400), "hexagonal", 14.04, 5.0, electrons=500.0)
    speckled = 60.0 + np.random.default_rng(2).exponential(1.0, white.shape) * (white - 60.0)
    with pytest.raises(PlenoPIVError, match=r"not white: of .* look like evenly lit discs: give an image"):
        find_lattice(np.minimum(speckled, 4000.0), camera_for((300, 400), "hexagonal", 14.04))


def test_independent_recording(tmp_path):
    """The lattice of a recording by the package's own ray tracer, which shares no code with the calibration: offset and
    rotation have the same signs in (s, t). The particle image of the same recording shows the lattice too, but is no
    white image.
    """
    import tifffile

    lattice = Lattice("hexagonal", 0.077, np.deg2rad(0.31), (0.0131, -0.0207))
    camera = PlenopticCamera(MainLens(50.0, 25.0, -1.0), lattice, 0.308, Sensor(600, 450, PIXEL_MM, 12, 60))
    made = simulate_recording(
        tmp_path / "recording",
        camera,
        flow("rotation"),
        dt_s=0.0005,
        volume_mm=((-1.2, 1.2), (-0.8, 0.8), (-2.0, 2.0)),
        rays=1000,
        seed=3,
    )
    folder, stated = made.directory, camera.with_lattice(Lattice("hexagonal", 0.0771))
    fit = find_lattice(tifffile.imread(folder / "white.tif"), stated)
    truth = json.loads((folder / "truth.json").read_text())
    assert truth["lattice_rotation_deg"] == pytest.approx(0.31)
    assert fit.residual_px < 0.02
    assert fit.worst_region_px < 0.005
    assert fit.lattice.pitch_mm == pytest.approx(0.077, rel=1e-5)
    assert fit.rotation_deg == pytest.approx(truth["lattice_rotation_deg"], abs=1e-3)
    assert fit.offset_mm == pytest.approx(truth["lattice_offset_mm"], abs=0.002 * PIXEL_MM)
    with pytest.raises(PlenoPIVError, match=r"a\.tif: "):
        find_lattice(tifffile.imread(folder / "a.tif"), stated, "a.tif")
