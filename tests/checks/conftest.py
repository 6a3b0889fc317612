"""Recordings that several tests look at, simulated once."""

import functools

import numpy as np
import pytest
from recordings import GOOD, copied, record

from plenopiv.checks import motion, white
from plenopiv.checks.motion import Motion


@pytest.fixture(scope="session", autouse=True)
def each_white_image_once():
    """Fitting the lattice takes most of a check's time, and many tests look at one white image."""

    def once(function):
        known = {}

        @functools.wraps(function)
        def remembered(image, camera, *name):
            key = image.tobytes(), camera
            if key not in known:
                known[key] = function(image, camera, *name)
            return known[key]

        return remembered

    with pytest.MonkeyPatch.context() as patch:
        for name in ("find_lattice", "aperture_disc"):
            patch.setattr(white, name, once(getattr(white, name)))
        yield


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
