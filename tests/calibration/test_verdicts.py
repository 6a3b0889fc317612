"""Images that cannot serve as white image are refused by the name of what is wrong; centroids contradict wrong fits."""

import numpy as np
import pytest
from white_images import camera_for, true_centres, white_image

from plenopiv.calibration import find_lattice
from plenopiv.calibration.verdict import centroid_words
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning

SHAPE = (300, 340)


def refused(white, kind="hexagonal", pitch_px=14.04):
    with pytest.raises(PlenoPIVError) as error:
        find_lattice(white, camera_for(SHAPE, kind, pitch_px), "w.tif")
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.full
def test_particles_are_not_white():
    """Light that differs from microlens to microlens, as that of particles far out of focus, though discs are whole."""
    white = white_image(SHAPE, "hexagonal", 14.04, dust=0.0)
    s, t = true_centres(SHAPE, "hexagonal", 14.04, 0.0, (0.0, 0.0))
    light = np.random.default_rng(3).uniform(0.3, 1.7, s.size)
    column, row = (SHAPE[1] - 1) / 2 - s, (SHAPE[0] - 1) / 2 + t
    c, r = np.arange(SHAPE[1])[None], np.arange(SHAPE[0])[:, None]
    nearest = np.argmin((c[..., None] - column) ** 2 + (r[..., None] - row) ** 2, -1)
    assert refused(60 + (white.astype(float) - 60) * light[nearest]).startswith("w.tif: not white: ")


@pytest.mark.parametrize("electrons", [0.3, 0.0])
def test_too_dim(electrons):
    white = white_image(SHAPE, "hexagonal", 14.04, electrons=electrons)
    assert refused(white).startswith("w.tif: too dim: ")


@pytest.mark.parametrize(("fill", "electrons"), [(1.0, 6000), (1.0, 1e5), (1.15, 6000), (1.15, 1e5)])
def test_overexposed(fill, electrons):
    white = white_image(SHAPE, "hexagonal", 14.04, fill=fill, electrons=electrons)
    with pytest.warns(PlenoPIVWarning, match="are saturated"):
        assert refused(white).startswith("w.tif: overexposed: ")


def test_an_image_without_much_saturation_is_judged_by_what_it_shows():
    white = white_image(SHAPE, "hexagonal", 14.04)
    white[:60] = 4095
    with pytest.warns(PlenoPIVWarning, match="are saturated"):
        assert refused(white, "square").startswith("w.tif: another lattice: ")


def test_too_distorted():
    """Waves of 3 px across the array, which no cubic describes."""
    s, t = true_centres((340, 380), "hexagonal", 14.04, 0.0, (0.0, 0.0))
    white = white_image(SHAPE, "hexagonal", 14.04, centres=(s + 3.0 * np.sin(t / 25.0), t))
    assert refused(white).startswith("w.tif: too distorted: ")


def test_another_lattice():
    white = white_image(SHAPE, "hexagonal", 14.04)
    assert refused(white, "square").startswith("w.tif: another lattice: shows a hexagonal lattice")
    assert refused(white, pitch_px=15.0).startswith("w.tif: another lattice: shows microlenses ")


@pytest.mark.parametrize("fill", [0.6, 0.9, 1.0])
def test_centroids_contradict_centres_that_are_off(fill):
    white = white_image(SHAPE, "square", 20.0, fill=fill, dust=0.0)[:, ::-1]
    s, t = true_centres(SHAPE, "square", 20.0, 0.0, (0.0, 0.0))
    inside = (abs(s) < 140) & (abs(t) < 120)
    centres = s[inside] + 1j * t[inside]
    assert centroid_words(white, centres, 20.0) is None
    assert "px from the centres fitted" in centroid_words(white, centres + 1.6 - 1.2j, 20.0)
