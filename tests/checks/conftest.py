"""Recordings that several tests look at, simulated once."""

import numpy as np
import pytest
from recordings import GOOD, copied, record

from plenopiv.checks import motion
from plenopiv.checks.motion import Motion


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """A function that gives the folder of a good recording by its name; not to be changed."""
    made = {}

    def folder(name="hexagonal"):
        if name not in made:
            made[name] = record(tmp_path_factory.mktemp("good") / "recording", **GOOD[name])
        return made[name]

    return folder


@pytest.fixture
def still(monkeypatch):
    """Nothing moves: spares looking for the displacement where a test is of something else."""
    found = Motion(np.zeros((1, 3)), np.zeros((1, 3)), 1.0)
    monkeypatch.setattr(motion, "motion", lambda *given: found)


@pytest.fixture
def recording(recorded, tmp_path):
    """A good recording in a folder of its own."""
    return copied(recorded(), tmp_path / "recording")
