"""Dark images of another gain, counts in other bits, spots and pixels that are full: what is said of them."""

import numpy as np
import pytest
import tifffile
from recordings import camera, looked_at, record
from scipy.ndimage import median_filter

from plenopiv.checks import filtered
from plenopiv.checks.light import are_hot, clipping
from plenopiv.checks.static import of_files, spot
from plenopiv.checks.white import white_image
from plenopiv.experiment import Experiment
from plenopiv.recording.static_light import static_light
from plenopiv.sensor import Sensor

SENSOR = Sensor(300, 280, 0.0055, 12, 60)


def flat(counts):
    return np.full((SENSOR.rows, SENSOR.columns), counts, np.uint16)


@pytest.mark.parametrize("counts", [4, 45, 75, 120, 960])
def test_a_dark_image_of_another_level_is_named(counts):
    found = [one for one in of_files(static_light(SENSOR, flat(counts), None), "dark.tif") if one.severity != "good"]
    if counts in (45, 75):  # darkness differs a little from what a data sheet says
        counts = 60
    assert [one.name for one in found] == ([] if counts == 60 else ["dark-level"])
    for one in found:
        assert f"pixels of dark.tif hold {counts} counts, where black_level = 60" in one.words


def test_a_background_below_the_dark_image_is_of_no_use():
    found = of_files(static_light(SENSOR, flat(60), (flat(7), flat(8))), "dark.tif")[-1]
    assert (found.name, found.severity) == ("static-light", "warning")
    assert "darker than a pixel without light" in found.words


def test_a_dark_image_is_named_where_frames_lie_below_it(recording):
    """Not the black level, which it is taken for."""
    changed = recording / "dark.tif"
    tifffile.imwrite(changed, np.full((364, 392), 120, np.uint16))
    found = {one.name: one for one in looked_at(recording, recording__dark="dark.tif").findings}
    assert "counts below those of dark.tif" in found["black-level"].words
    assert "black_level" not in found["black-level"].advice
    assert "unequal-pulses" not in found  # of what little is left
    assert found["dark-level"].severity == "warning"


@pytest.mark.full
def test_micro_images_without_a_whole_pixel(tmp_path):
    """Main lens stopped down: moments of light need pixels that are lit as a whole."""
    found = looked_at(record(tmp_path / "small", camera(aperture=0.2))).findings
    assert [one.name for one in found if one.severity == "unusable"] == ["underexposed"]
    assert any("none of their pixels" in one.words for one in found)


@pytest.mark.parametrize(("scale", "bits", "says"), [(16, 16, "12 bits in the upper part"), (65535 / 4095, 16, None)])
def test_counts_with_gaps_are_not_taken_for_filtered_ones(scale, bits, says):
    light = np.random.default_rng(0).poisson(400.0, (280, 300))
    counts = np.round(scale * (light + 60)).astype(np.uint16)
    found = filtered.of_frame(counts, Sensor(300, 280, 0.0055, bits, 60 * scale), "a.tif")
    assert (found is None) == (says is None)
    assert found is None or (says in found.words and found.severity == "good")
    assert filtered.of_frame(np.round(light + 60).astype(np.uint16), SENSOR, "a.tif") is None


def test_saturated_pixels_in_the_upper_bits_are_not_filtered_ones():
    counts = np.random.default_rng(0).poisson(400.0, (280, 300)).astype(np.uint16)
    counts[:120] = 4095
    assert filtered.of_frame(16 * counts, Sensor(300, 280, 0.0055, 16, 960), "a.tif").name == "upper-bits"


def test_filtered_counts_in_the_upper_bits_are_still_named():
    counts = 16 * median_filter(np.random.default_rng(0).poisson(400.0, (280, 300)), 3).astype(np.uint16)
    assert filtered.of_frame(counts, Sensor(300, 280, 0.0055, 16, 960), "a.tif").name == "filtered"


@pytest.mark.parametrize("radius", [12, 48])
def test_a_saturated_reflection_is_named_however_large(radius):
    """Its own light makes particles look bright; one microlens that a particle fills is none."""
    y, x = np.indices((SENSOR.rows, SENSOR.columns))
    frames = [60 + np.random.default_rng(k).poisson(30.0, x.shape).astype(np.float32) for k in (1, 2)]
    for frame in frames:
        frame[np.hypot(y - 110, x - 200) < radius] = SENSOR.full_scale
    found = spot(*frames, SENSOR, 14.0, 1e5)
    if radius < 20:
        assert found is None
        return
    assert found.name == "static-light"
    assert "(column, row) = (" in found.words
    column, row = map(int, found.words.split("= (")[1].split(")")[0].split(","))
    assert np.hypot(row - 110, column - 200) < radius


def test_full_pixels_that_are_alone_are_hot():
    counts, rng = flat(100), np.random.default_rng(3)
    counts.flat[rng.choice(counts.size, 40, replace=False)] = SENSOR.full_scale
    assert are_hot(counts >= SENSOR.full_scale)
    assert "dark image" in clipping(counts, SENSOR, "a.tif").advice
    counts[40:60, 50:70] = SENSOR.full_scale
    assert not are_hot(counts >= SENSOR.full_scale)
    assert "less light" in clipping(counts, SENSOR, "a.tif").advice


def test_a_dead_row_is_no_subtracted_black_level(recorded):
    folder = recorded("hexagonal")
    of = Experiment.load(folder / "experiment.toml").camera()
    white = tifffile.imread(folder / "white.tif")
    dead = white.copy()
    dead[97:100] = 0
    below, dim = white - 60, white < np.percentile(white, 5)  # between micro-images noise is left, half of it cut off
    below[dim] = np.maximum(np.random.default_rng(0).normal(0, 3, dim.sum()), 0)
    words = [
        next(
            one
            for one in white_image(image, of, "white.tif", True, 4000.0, folder / "white.tif")[0]
            if one.name == "dead-pixels"
        )
        for image in (dead, below)
    ]
    assert ["subtracts" in one.words for one in words] == [False, True]
    assert ["black_level = 0" in one.advice for one in words] == [False, True]
