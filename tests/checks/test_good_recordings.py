"""Good recordings: nothing is found fault with, and the numbers are those of the simulation."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import GOOD, PPM, VELOCITY_M_S, camera, edited, looked_at, record, wrong

from plenopiv.checks import whole_recording
from plenopiv.checks.motion import motion
from plenopiv.lightfield import decode, layout
from plenopiv.recording import read_image
from plenopiv.simulation.sensor_noise import SensorNoise

VOXEL_MM = np.array([36 / 2100, 36 / 2100, 0.077])


LATER = (
    "dim",
    "square",
    "hexagonal turned",
    "square, 14.04 px",
    "stored as on the chip",
)  # of the full set: make test has the one's lattice and the other's angle in others


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.full) if n in LATER else n for n in GOOD])
def test_a_good_recording_is_called_good(recorded, name):
    found = looked_at(recorded(name))
    assert wrong(found) == {}
    assert found.usable
    of_electrons = GOOD[name].get("electrons_per_pixel", 400.0)
    gain = GOOD[name].get("noise", SensorNoise()).gain
    # <E^2>/<E> of particles that differ by 25 %
    assert found.light.particle == pytest.approx(gain * of_electrons * (1 + 0.25**2), rel=0.15)
    assert found.light.ppm == pytest.approx(PPM, rel=0.2)
    assert found.light.background < 4.0  # 4 electrons of stray light are 2 counts
    assert found.fit.shift_px < 0.15
    expected = np.array(VELOCITY_M_S) * 0.5 / VOXEL_MM
    assert np.median(found.motion.displacement_mm, 0) / VOXEL_MM == pytest.approx(expected, abs=0.6)


@pytest.mark.parametrize(
    ("axis", "sign"),
    [(0, 1), (1, -1), (2, 1), *(pytest.param(*other, marks=pytest.mark.full) for other in ((0, -1), (1, 1), (2, -1)))],
)
def test_the_displacement_has_the_sign_of_the_motion(tmp_path, axis, sign):
    velocity = np.array([0.0, 0.0, 0.0] if axis < 2 else [0.11, -0.06, 0.0])
    velocity[axis] = sign * (0.15, 0.15, 0.45)[axis]
    folder = record(tmp_path / "recording", velocity_m_s=tuple(velocity))
    where = layout(camera())
    fields = [decode(read_image(folder / f"{name}.tif"), where) for name in "ab"]
    moved = np.median(motion(*fields, (-1.6, 1.6)).displacement_mm, 0)
    assert moved / VOXEL_MM == pytest.approx(velocity * 0.5 / VOXEL_MM, abs=0.8)
    assert sign * moved[axis] > 0.5 * abs(velocity[axis]) * 0.5


@pytest.mark.full
def test_what_no_image_tells(recording):
    """All images turned, or frames in the wrong order without times: the check cannot see it, the guide says so."""
    for name in ("a", "b", "white"):
        edited(recording, name, lambda image: image[::-1, ::-1])
    assert wrong(looked_at(recording)) == {}
    backwards = looked_at(recording, recording__frames=["b.tif", "a.tif"])
    assert wrong(backwards) == {}
    # turned once and reversed in time: x and y as they are, z reversed
    expected = np.array(VELOCITY_M_S) * (1, 1, -1) * 0.5 / VOXEL_MM
    assert np.median(backwards.motion.displacement_mm, 0) / VOXEL_MM == pytest.approx(expected, abs=0.6)


def test_a_volume_beside_the_sensor_s_middle(tmp_path, monkeypatch):
    """Its light is looked for where it is; in the middle there was none, and the recording was refused."""
    wide = replace(camera(), sensor=replace(camera().sensor, columns=800))
    record(tmp_path / "beside", wide, x_mm=(0.6, 2.0))
    monkeypatch.setattr(whole_recording, "MIDDLE_PX", 200)
    found = looked_at(tmp_path / "beside")
    assert wrong(found) == {}
    assert found.light.particle == pytest.approx(0.5 * 400 * (1 + 0.25**2), rel=0.2)
