"""A beam narrower than the field, on one side of focus: particles light one side of micro-images; nothing has moved."""

import numpy as np
import pytest
from recordings import camera, copied, edited, looked_at, white_of, wrong

from plenopiv.checks import PairCheck, fit
from plenopiv.experiment import Experiment
from plenopiv.recording import read_image
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

ELSEWHERE = {fit.MOVED, fit.OTHER_CAMERA, "flipped"}


def narrow(folder, kind, z_mm):
    return simulate_recording(
        folder,
        camera(kind),
        flow("uniform", velocity_m_s=(0.05, -0.06, 0.17)),
        dt_s=0.0005,
        volume_mm=((-0.4, 0.4), (-0.4, 0.4), z_mm),
        windows=((32, 32, 20), (24, 24, 16)),
        seeding=Seeding(0.8),
        rays=2000,
        seed=3,
    ).directory


@pytest.fixture(scope="module")
def before_focus(tmp_path_factory):
    return narrow(tmp_path_factory.mktemp("narrow") / "recording", "hexagonal", (2.0, 6.0))


def test_the_pattern_of_light_alone_would_be_taken_for_another_camera(before_focus):
    """What is settled here by outlines: without them this recording was refused."""
    images = [read_image(before_focus / f"{name}.tif").astype(float) - 60 for name in ("a", "white")]
    assert fit.fit(*images, camera().image_pitch_px).shift_px > fit.MOVED_PX


def test_a_narrow_beam_before_focus_is_good(before_focus):
    assert not wrong(looked_at(before_focus)).keys() & ELSEWHERE
    experiment = Experiment.load(before_focus / "experiment.toml")
    found = looked_at(before_focus)
    pair = PairCheck(experiment.recording().sensor, found.white, found.camera)
    images = tuple(read_image(before_focus / f"{name}.tif") for name in "ab")
    assert not {finding.name for finding in pair.findings(images, ("a", "b"))} & ELSEWHERE


@pytest.mark.full
@pytest.mark.parametrize(("kind", "z_mm"), [("square", (2.0, 6.0)), ("hexagonal", (-6.0, -2.0)), ("square", (0.5, 4))])
def test_so_are_others(tmp_path, kind, z_mm):
    assert not wrong(looked_at(narrow(tmp_path / "recording", kind, z_mm))).keys() & ELSEWHERE


@pytest.mark.parametrize(
    "shift", [1, pytest.param(-3, marks=pytest.mark.full), pytest.param(6, marks=pytest.mark.full)]
)
def test_an_array_that_moved_is_noticed(before_focus, tmp_path, shift):
    folder = copied(before_focus, tmp_path / "recording")
    edited(folder, "white", lambda image: np.roll(image, shift, 1))
    assert wrong(looked_at(folder)).keys() & ELSEWHERE


@pytest.mark.parametrize("other", [camera(rotation_rad=0.03, offset_mm=(0.03, 0.0)), camera(pmr=14.15)], ids=str)
def test_another_camera_is_noticed(before_focus, tmp_path, other):
    folder = copied(before_focus, tmp_path / "recording")
    edited(folder, "white", lambda image: white_of(other))
    assert wrong(looked_at(folder)).keys() & ELSEWHERE
