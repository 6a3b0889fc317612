"""What a check makes of faults, in numbers; what the user reads of them is in test_on_the_command_line."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from recordings import camera, edited, looked_at, record, white_of, wrong

from plenopiv.checks.findings import Finding
from plenopiv.checks.first_pair import worst
from plenopiv.checks.fit import TURNS, finding, fit
from plenopiv.checks.stamps import in_order, stamp
from plenopiv.checks.static import common_light, glow, of_files, pulses
from plenopiv.checks.white import white_image
from plenopiv.recording.sources import only_source
from plenopiv.recording.static_light import static_light
from plenopiv.sensor import Sensor


def test_wrong_lattice_type(recorded):
    found = looked_at(recorded(), camera__microlens_array__lattice="square")
    assert not found.usable
    assert "shows a hexagonal lattice" in wrong(found)["lattice-type"].words
    assert 'set it to "hexagonal"' in wrong(found)["lattice-type"].advice


@pytest.mark.parametrize(
    ("name", "said"), [("a.h5::run/white", True), ("a.npy", True), ("a.tif", False), (None, False)]
)
def test_arrays_with_axes_reversed(name, said):
    """As MATLAB writes them; of pictures the rows are known."""
    whole = white_of(camera())
    path = None if name is None else Path(name)
    upright, _ = white_image(whole, camera(), "white", path=path)
    assert "array-transposed" not in [finding.name for finding in upright]
    turned = replace(camera(), sensor=replace(camera().sensor, rows=whole.shape[1], columns=whole.shape[0]))
    findings, _ = white_image(np.ascontiguousarray(whole.T), turned, "white", path=path)
    assert ("array-transposed" in [finding.name for finding in findings]) == said


@pytest.mark.full
@pytest.mark.parametrize(
    ("aperture", "stated"),
    [
        (0.85, True),
        (1.15, False),
        (0.85, False),
        (1.15, True),
    ],
)
@pytest.mark.usefixtures("still")
def test_f_number_mismatch(recording, aperture, stated):
    """Measured in the white image, whether the experiment file knows of it or not."""
    edited(recording, "white", lambda image: white_of(camera(aperture=aperture)))
    changes = {"camera__main_lens__aperture_mm": 25.0 * aperture} if stated else {}
    fault = wrong(looked_at(recording, **changes))["f-number"]
    assert "f-numbers do not match" in fault.words
    assert ("dark pixels" if aperture < 1 else "overlap") in fault.words
    assert fault.number == pytest.approx(100 * aperture, abs=1.0)
    assert fault.advice.startswith("open" if aperture < 1 else "close")
    assert float(fault.advice.rpartition("= ")[2]) == pytest.approx(25 * aperture, rel=0.01)


@pytest.mark.full
@pytest.mark.usefixtures("still")
def test_an_aperture_that_is_not_the_stated_one(recorded):
    fault = wrong(looked_at(recorded(), camera__main_lens__aperture_mm=20.0))["stated-aperture"]
    assert "aperture_mm = 25" in fault.advice


@pytest.mark.full
def test_the_aperture_of_a_camera_with_a_target_is_not_the_stated_one(recorded):
    image = tifffile.imread(recorded() / "white.tif")
    for stated in (True, False):
        findings, fit = white_image(image, camera(aperture=0.8), "white.tif", stated)
        assert fit is not None
        assert ("stated-aperture" in {finding.name for finding in findings}) == stated
    findings, _ = white_image(white_of(camera(aperture=1.15)), camera(), "white.tif", stated=False)
    (fault,) = [finding for finding in findings if finding.name == "f-number"]
    assert fault.severity == "warning"
    assert "aperture_mm" not in fault.advice


@pytest.mark.full
@pytest.mark.usefixtures("still")
def test_cut_off_below_full_scale(recording):
    edited(recording, "a", lambda image: np.minimum(image * 8, 3500))
    edited(recording, "b", lambda image: np.minimum(image * 8, 3500))
    assert "3500 counts, below full scale of 4095" in wrong(looked_at(recording))["overexposed"].words


def test_frames_without_particles(recording):
    rng = np.random.default_rng(0)
    for name in "ab":
        edited(recording, name, lambda image: np.rint(rng.normal(62, 1.5, image.shape)))
    found = looked_at(recording)
    assert not found.usable
    assert {"underexposed", "white-fits-frames"} <= wrong(found).keys()
    assert "shows no microlenses" in wrong(found)["white-fits-frames"].words


@pytest.mark.full
def test_too_dense(tmp_path):
    found = looked_at(record(tmp_path / "r", particles_per_microlens=7.0, electrons_per_pixel=150.0))
    assert wrong(found).keys() == {"too-dense"}
    assert found.light.ppm == pytest.approx(7.0, rel=0.25)


@pytest.mark.usefixtures("still")
def test_too_thin(tmp_path):
    assert "too-thin" in wrong(looked_at(record(tmp_path / "r", particles_per_microlens=0.08)))


@pytest.mark.full
@pytest.mark.usefixtures("still")
def test_stray_light_and_a_wrong_black_level(recording):
    for name in "ab":
        edited(recording, name, lambda image: image + 80)
    assert wrong(looked_at(recording))["background"].number == pytest.approx(82, rel=0.2)
    found = looked_at(recording, camera__sensor__black_level=260.0)
    assert "black-level" in wrong(found)


FLIPS = {
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
}


@pytest.mark.parametrize("way", FLIPS)
@pytest.mark.parametrize("which", [pytest.param("white", marks=pytest.mark.full), "frames", "one frame"])
def test_white_image_and_frames_flipped_against_each_other(recording, way, which):
    for name in {"white": ["white"], "frames": ["a", "b"], "one frame": ["b"]}[which]:
        edited(recording, name, FLIPS[way])
    fault = wrong(looked_at(recording))["flipped"]
    assert fault.severity == "unusable"
    assert way in fault.words
    assert ("a.tif" in fault.words) == (which != "one frame")


def test_what_little_light_falls_beside_the_volume_says_nothing(recorded):
    """It lights one side of the micro-images: blocks of it seem to lie pixels off the white image's."""
    folder = recorded("hexagonal")
    frame, white = (tifffile.imread(folder / f"{name}.tif") - 60.0 for name in ("a", "white"))
    frame, width = np.tile(frame, (1, 3)), frame.shape[1]
    white = np.tile(white, (1, 3))
    frame[:, width:] = 0.08 * np.roll(frame[:, width:], 5, 1)
    found = fit(frame, white, 14.04)
    assert finding(found, "a.tif").severity == "good"
    assert found.shift_px < 0.2
    assert 0 < len(found.shifts_px) == len(found.centres_px) < 9


@pytest.mark.parametrize("kind", [pytest.param("square", marks=pytest.mark.full), "hexagonal"])
@pytest.mark.parametrize("way", TURNS)
def test_turns_of_a_square_sensor(recorded, kind, way):
    """By 90 degrees as well; on the common square of a sensor."""
    folder = recorded(kind)
    frame, white = (tifffile.imread(folder / f"{name}.tif")[:364, :364] - 60.0 for name in ("a", "white"))
    turned = TURNS[way](white)
    back = {"turned by 90 degrees clockwise": "turned by 90 degrees counter-clockwise"}
    back |= {other: one for one, other in back.items()}
    found = finding(fit(frame, turned, 14.04), "a.tif")
    if way == "as it is":
        assert found.severity == "good"
    else:
        assert back.get(way, way) in found.words


@pytest.mark.full
@pytest.mark.parametrize(
    "other",
    [
        camera(rotation_rad=0.021, offset_mm=(-0.03, 0.005)),
        camera(rotation_rad=0.004, offset_mm=(0.03, 0.0)),
    ],
)
def test_white_image_of_another_camera(recording, other):
    edited(recording, "white", lambda image: white_of(other))
    found = wrong(looked_at(recording))
    assert found.keys() == {"other-camera"}
    fault = found["other-camera"]
    assert fault.severity == "unusable"
    assert "another camera's" in fault.words
    assert fault.number > 2.0


def test_the_white_image_of_another_camera_has_not_moved_a_little():
    moved = Finding("white-moved", "warning", "b.tif", 7.1)
    other = Finding("other-camera", "unusable", "a.tif", 7.1)
    assert worst([other, moved]) == [other]
    assert worst([moved]) == [moved]


def test_white_image_of_a_camera_with_another_array(recording):
    edited(recording, "white", lambda image: white_of(camera(pmr=12.0)))
    fault = wrong(looked_at(recording))["no-lattice"]
    assert "microlenses 66.0" in fault.words


@pytest.mark.full
@pytest.mark.usefixtures("still")
def test_a_lens_that_moved_a_little(recording):
    edited(recording, "white", lambda image: white_of(camera(offset_mm=(0.011 + 0.6 * 0.0055, -0.023))))
    assert wrong(looked_at(recording))["white-moved"].number == pytest.approx(0.6, abs=0.2)


def test_cameras_that_files_name(recording):
    model = [(272, "s", 0, "Kestrel 29\x1b[31m", True)]
    edited(recording, "a", lambda image: image, extratags=model)
    edited(recording, "white", lambda image: image, extratags=[(272, "s", 0, "Merlin 4", True)])
    words = wrong(looked_at(recording))["other-camera"].words
    assert "camera model 'Merlin 4'" in words
    assert "'Kestrel 29[31m'" in words  # nothing that a terminal would obey


@pytest.mark.usefixtures("still")
def test_frames_out_of_order(recording):
    edited(recording, "a", lambda image: image, datetime="2026:03:02 10:00:01")
    edited(recording, "b", lambda image: image, datetime="2026:03:02 10:00:00")
    found = looked_at(recording)
    assert not found.usable
    assert "b.tif was taken 1 s before a.tif" in wrong(found)["out-of-order"].words
    assert wrong(looked_at(recording, recording__frames=["b.tif", "a.tif"])) == {}


def test_times_that_contradict_dt(tmp_path):
    marks = []
    for k, below in enumerate(("000000", "000500", "010500")):
        path = tmp_path / f"{k}.tif"
        image = np.arange(400, dtype=np.uint16).reshape(20, 20)
        tags = [(37520, "s", 0, below, True)]
        tifffile.imwrite(path, image, datetime="2026:03:02 10:00:00", extratags=tags)
        marks.append((path.name, stamp(only_source(path))))
    assert in_order(marks[:2], 0.0005).severity == "good"
    assert in_order(marks[:2], 0.001).name == "uneven-times"
    assert "0.0005 to 0.01 s apart" in in_order(marks, 0.0005).words
    assert in_order(marks[:1], 0.0005).severity == "good"


@pytest.mark.full
@pytest.mark.parametrize(("gain", "name"), [(1 / 40, "white-underexposed"), (2.0, "white-overexposed")])
def test_a_white_image_too_dark_and_too_bright(recorded, gain, name):
    image = np.minimum(60 + (tifffile.imread(recorded() / "white.tif") - 60.0) * gain, 4095)
    findings, _ = white_image(image, camera(), "white.tif")
    assert name in {finding.name for finding in findings if finding.severity == "warning"}


def test_counts_of_twelve_bits_that_are_called_sixteen():
    sixteen = replace(camera(), sensor=replace(camera().sensor, bit_depth=16, black_level=60))
    white = np.full((sixteen.sensor.rows, sixteen.sensor.columns), 1500.0)

    def advice(frames_reach, of=sixteen, gain=1.0):
        findings, _ = white_image(60 + gain * white, of, "white.tif", frames_reach=frames_reach)
        return next(one.advice for one in findings if one.name == "white-underexposed")

    assert advice(900.0).endswith("; or is camera.sensor.bit_depth 12?")
    assert "bit_depth" not in advice(60000.0)  # a frame fills 16 bits
    assert "bit_depth" not in advice(4000.0, gain=0.05)  # too dark for 12 bits too
    assert "bit_depth" not in advice(3000.0, of=camera(), gain=0.05)  # frames fill the 12 that are stated
    shifted = replace(camera(), sensor=replace(camera().sensor, alignment="high"))
    assert advice(3000.0, of=shifted, gain=0.05).endswith("in the lower bits, unlike those of the frames?")
    assert "lower bits" not in advice(3000.0, of=camera(), gain=0.05)


@pytest.mark.full
def test_displacements_beyond_the_search_range(recorded):
    fault = wrong(looked_at(recorded(), correlation__windows=[[32, 32, 16], [16, 16, 16]], correlation__search=0.06))
    assert "larger first windows" in fault["displacement-too-large"].advice


@pytest.mark.full
def test_frames_of_two_flows(recording):
    folder = record(recording.parent / "other", seed=4)
    edited(recording, "b", lambda image: tifffile.imread(folder / "b.tif"))
    fault = wrong(looked_at(recording))
    assert "no common displacement" in fault["displacement"].words


@pytest.mark.usefixtures("still")
def test_without_a_white_image(recording):
    lattice = {"camera__microlens_array__rotation_deg": 0.2292, "camera__microlens_array__offset_mm": [0.011, -0.023]}
    (recording / "white.tif").unlink()
    text = (recording / "experiment.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("white =")]
    stated = [
        f"{line}\nrotation_deg = 0.2292\noffset_mm = [0.011, -0.023]" if line.startswith("pitch_mm") else line
        for line in lines
    ]
    (recording / "experiment.toml").write_text("\n".join(stated))
    found = looked_at(recording, **lattice)
    assert wrong(found) == {}
    assert found.fit is None
    assert found.light.ppm == pytest.approx(1.0, rel=0.2)


def static_scene(pairs, static, seed=0):
    """First frames of pairs: particles at random, and the same static light in all; counts of a small sensor."""
    rng = np.random.default_rng(seed)
    frames = []
    for _ in range(pairs):
        light = np.where(rng.random(static.shape) < 0.3, rng.uniform(20, 200, static.shape), 0.0)
        frames.append(np.rint(60 + light + static + rng.normal(0, 1.5, static.shape)).astype(np.uint16))
    return frames


def test_light_that_all_pairs_share_is_static():
    sensor, nothing = Sensor(300, 280, 0.0055, 12, 60), np.zeros((280, 300))
    reflection = nothing.copy()
    reflection[100:120, 150:170] = 120.0
    assert common_light(static_scene(8, nothing), sensor) is None
    assert common_light(static_scene(3, reflection), sensor) is None  # too few to tell
    found = common_light(static_scene(8, reflection), sensor)
    assert (found.name, found.severity) == ("static-light", "warning")
    assert found.number == pytest.approx(120, abs=15)
    assert "recording.background" in found.advice


def test_particles_so_dense_that_every_pixel_is_lit_are_not_static_light():
    sensor, rng = Sensor(300, 280, 0.0055, 12, 60), np.random.default_rng(2)
    rows, columns = np.mgrid[:280, :300]
    volume = (abs(rows - 140) < 90) & (abs(columns - 150) < 100)  # particles beside it light no pixel
    micro = np.hypot(rows % 14 - 7, columns % 14 - 7) < 6.5
    dense = [np.rint(60 + volume * micro * rng.gamma(3.0, 80.0, micro.shape)).astype(np.uint16) for _ in range(8)]
    assert np.percentile(np.minimum.reduce(dense), 99.9) > 160
    assert common_light(dense, sensor) is None
    glow = 250.0 * np.exp(-(np.hypot(rows - 140, columns - 150) ** 2) / 2 / 80.0**2)
    assert common_light([np.rint(frame + micro * glow).astype(np.uint16) for frame in dense], sensor) is not None


def glowing_pair(peak, share_lit, at=(168, 392)):
    """Two frames of particles of 20 to 400 counts, ``share_lit`` of the pixels, in micro-images, with a glow of
    ``peak`` counts around (row, column), and the white image."""
    rng, (rows, columns) = np.random.default_rng(3), np.mgrid[:560, :672]
    micro = np.hypot(rows % 14 - 7, columns % 14 - 7) < 6.0
    light = peak * np.exp(-(np.hypot(rows - at[0], columns - at[1]) ** 2) / 2 / 100.0**2)
    frames = []
    for _ in range(2):
        lit = np.where(rng.random(rows.shape) < share_lit, rng.uniform(20.0, 400.0, rows.shape), 0.0)
        frames.append(np.rint(60 + micro * (lit + light) + rng.normal(0, 1.5, rows.shape)).astype(np.uint16))
    return *frames, np.rint(60 + 3000 * micro).astype(np.uint16)


@pytest.mark.parametrize("share_lit", [0.1, 0.5])
def test_a_glow_in_both_frames_is_static_light(share_lit):
    sensor = Sensor(672, 560, 0.0055, 12, 60)
    assert glow(*glowing_pair(0.0, share_lit), sensor, 14.0, 200.0) is None
    assert glow(*glowing_pair(15.0, share_lit), sensor, 14.0, 200.0) is None  # less than costs accuracy
    found = glow(*glowing_pair(120.0, share_lit), sensor, 14.0, 200.0)
    assert (found.name, found.severity) == ("static-light", "warning")
    assert 50.0 < found.number < 120.0  # what the block's corners have more than most blocks
    assert "(column, row) = (392, 168)" in found.words
    assert glow(*glowing_pair(120.0, share_lit)[:2], None, sensor, 14.0, 200.0) is None  # gaps of micro-images are dark


def test_particles_so_dense_that_they_leave_no_pixel_dark_are_no_glow():
    rng, (rows, columns) = np.random.default_rng(4), np.mgrid[:560, :672]
    volume = (abs(rows - 280) < 120) & (abs(columns - 336) < 120)
    frames = [np.rint(60 + volume * rng.gamma(3.0, 80.0, rows.shape)).astype(np.uint16) for _ in range(2)]
    assert glow(*frames, None, Sensor(672, 560, 0.0055, 12, 60), 14.0, 200.0) is None


@pytest.mark.parametrize(
    ("second", "name", "severity"),
    [(100.0, "pulses", "good"), (70.0, "unequal-pulses", "good"), (40.0, "unequal-pulses", "warning"),
     (250.0, "unequal-pulses", "warning")],
)  # fmt: skip
def test_pulses_of_unequal_light_are_named(second, name, severity):
    found = pulses(100.0, second)
    assert (found.name, found.severity) == (name, severity)
    assert f"{second / 100:.2f} of the first" in found.words


def test_what_dark_and_background_images_show_is_named():
    sensor = Sensor(300, 280, 0.0055, 12, 60)
    dark = np.full((280, 300), 60, np.uint16)
    dark[3, 4] = 900
    static = np.zeros((280, 300))
    static[100:140, 150:190] = 200.0
    first = (dark + static).astype(np.uint16)
    second = (dark + 0.5 * static).astype(np.uint16)
    hot, light = of_files(static_light(sensor, dark, (first, second)))
    assert (hot.name, hot.number) == ("hot-pixels", 1.0)
    assert "up to 200 counts of the first pulse, 100 of the second" in light.words


@pytest.mark.parametrize("brightness", [pytest.param(0, marks=pytest.mark.full), 900])
def test_a_reflection_in_one_pair(recording, brightness):
    """Half a microlens wide and unsaturated; particles in focus give 200 counts."""
    for name in "ab":
        image = tifffile.imread(recording / f"{name}.tif").astype(float)
        row, column = np.mgrid[: image.shape[0], : image.shape[1]]
        image += brightness * np.exp(-((row - 250) ** 2 + (column - 120) ** 2) / (2 * 12.0**2))
        tifffile.imwrite(recording / f"{name}.tif", np.rint(image).astype(np.uint16))
    found = wrong(looked_at(recording)).get("static-light")
    if brightness:
        assert "(column, row)" in found.words
        column, row = map(int, re.search(r"= \((\d+), (\d+)\)", found.words).groups())
        assert abs(column - 120) < 10
        assert abs(row - 250) < 10
    else:
        assert found is None
