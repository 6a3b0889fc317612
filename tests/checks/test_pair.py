"""What a pair is asked as it comes: each fault on a made-up pair of frames, and none on a good one."""

import numpy as np
import pytest

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.checks.pair import PairCheck
from plenopiv.lattice import Lattice
from plenopiv.recording.static_light import static_light
from plenopiv.sensor import Sensor

SENSOR = Sensor(400, 360, 0.0055, 12, 60.0)
CAMERA = PlenopticCamera(MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077), 0.308, SENSOR)
NAMES = ("a.tif", "b.tif")


def frame(seed, light=40.0):
    rng = np.random.default_rng(seed)
    lit = rng.random((SENSOR.rows, SENSOR.columns)) < 0.3
    return np.rint(60 + lit * rng.exponential(3 * light, lit.shape) + rng.normal(0, 1.5, lit.shape)).clip(0, 4094)


def found(a, b):
    return {one.name: one for one in PairCheck(SENSOR, None, CAMERA).findings((a, b), NAMES)}


def dark(rows):
    image = frame(2)
    image[rows] = 60
    return image


def test_a_good_pair_has_no_finding():
    assert found(frame(1), frame(2)) == {}
    assert found(frame(1), frame(2, light=30.0)) == {}


@pytest.mark.parametrize("rows", [slice(0, 180), slice(300, 360)])
@pytest.mark.parametrize("first", [True, False])
def test_a_part_of_one_frame_is_dark(rows, first):
    pair = (dark(rows), frame(1)) if first else (frame(1), dark(rows))
    finding = found(*pair)["partly-dark"]
    assert finding.severity == "unusable"
    assert NAMES[0 if first else 1] in finding.words
    share = 100 * (rows.stop - rows.start) / SENSOR.rows
    assert finding.number == pytest.approx(share, abs=11)  # blocks are a fifth of a side


def test_what_both_frames_leave_dark_is_no_fault():
    both = [frame(seed) for seed in (1, 2)]
    for image in both:
        image[:180] = 60 + np.random.default_rng(9).normal(0, 1.5, image[:180].shape)
    assert found(*both) == {}


def test_one_image_twice():
    assert found(frame(1), frame(1))["same-frame"].severity == "unusable"


def test_a_weak_second_pulse_and_a_saturated_frame():
    assert found(frame(1), frame(2, light=15.0))["unequal-pulses"].severity == "warning"
    bright = frame(3)
    bright[bright > 62] = SENSOR.full_scale
    assert found(frame(1), bright)["overexposed"].severity == "unusable"


def test_a_saturated_frame_less_its_dark_image():
    """Where the dark image is below the black level, pixels that were just not full end above full scale."""
    bright = frame(3)
    bright[bright > 300] = SENSOR.full_scale
    bright[0, 0] = SENSOR.full_scale - 1
    dark = static_light(SENSOR, np.full(bright.shape, 58, np.uint16), None)
    a, b = (dark.removed(image.astype(np.uint16), 0)[0] for image in (frame(1), bright))
    assert b.max() > SENSOR.full_scale
    assert found(a, b)["overexposed"].number == pytest.approx(100 * np.mean(bright >= SENSOR.full_scale - 1))


def test_pixels_that_are_no_equations_are_not_asked():
    bright = frame(3)
    bright[:200] = SENSOR.full_scale
    masked = np.zeros(bright.shape, bool)
    masked[:200] = True
    found = PairCheck(SENSOR, None, CAMERA, masked).findings((frame(1), bright), NAMES)
    assert found == []
