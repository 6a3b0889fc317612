"""The search for particles in what is left: scores by summing each ray of a place, and maxima by looking at all."""

from math import floor, pi

import numpy as np
import pytest

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.sensor import Sensor
from plenopiv.tracking import search
from plenopiv.tracking.light import PointLights

LIMITS = ((-0.5, 0.5), (-0.4, 0.45), (-2.0, 2.5))
BENT = LatticeMap(2, 0.6, ((0.0, 0.01), (0.02, 0.0), (0.01, 0.0), (0.0, 0.0), (0.0, -0.01)))


def camera_of(kind, turn=0.0, bent=None):
    lattice = Lattice(kind, 0.077, turn, (0.011, -0.023), bent)
    return PlenopticCamera(MainLens(50.0, 25.0, -1.0), lattice, 0.308, Sensor(200, 180, 0.0055, 12, 60))


def rays_of(camera):
    """Where rays cross the main lens: on Vogel's spiral, one for about a pixel."""
    n = round(pi * camera.aperture_radius_px**2)
    turn = 2.0 * pi * (5.0**0.5 - 1.0) / 2.0 * np.arange(n)
    r = 0.5 * camera.main_lens.aperture_mm * 0.97 * np.sqrt((np.arange(n) + 0.5) / n)
    return np.stack([r * np.cos(turn), r * np.sin(turn)], -1)


def score_of(camera, excess, place):
    """The score of one place, ray by ray."""
    e, image = camera.image_scale, excess.reshape(camera.sensor.rows, camera.sensor.columns)
    scale, spread = float(camera.scale(place[2])), float(camera.spread(place[2]))
    column0, row0 = camera.sensor.axis
    found, rays = [], rays_of(camera)
    regular = PlenopticCamera(
        camera.main_lens,
        Lattice(camera.lattice.kind, 0.077, camera.lattice.rotation_rad, camera.lattice.offset_mm),
        0.308,
        camera.sensor,
    ).lattice
    for u, v in rays:
        i, j = regular.nearest(spread * u + scale * place[0], spread * v + scale * place[1])
        s, t = camera.lattice.centres(i, j)
        column = floor(column0 - ((1.0 + e) * s - e * u) / camera.sensor.pixel_pitch_mm + 0.5)
        row = floor(row0 + ((1.0 + e) * t - e * v) / camera.sensor.pixel_pitch_mm + 0.5)
        if 0 <= column < camera.sensor.columns and 0 <= row < camera.sensor.rows and np.isfinite(image[row, column]):
            found.append(np.clip(image[row, column], -search.MOST, search.MOST))
    return sum(found) / len(found) ** 0.5 if len(found) > search.SEEN * len(rays) else 0.0


@pytest.mark.parametrize(
    "camera",
    [
        camera_of("hexagonal"),
        camera_of("square"),
        camera_of("hexagonal", 0.02),
        camera_of("square", -0.05),
        camera_of("hexagonal", 0.01, BENT),
    ],
    ids=["hexagonal", "square", "turned", "square, turned", "bent"],
)
def test_scores_are_sums_over_rays(camera, monkeypatch):
    monkeypatch.setattr(search, "APART_PITCHES", 0.02)
    rng = np.random.default_rng(1)
    excess = rng.normal(0.9, 2.0, camera.sensor.rows * camera.sensor.columns)
    excess[rng.random(excess.size) < 0.05] = np.nan
    place, score = PointLights(camera).places(excess, LIMITS)
    assert len(score) > 500
    assert (np.diff(score) <= 0.0).all()
    assert all((lo <= place[:, k]).all() and (place[:, k] <= hi).all() for k, (lo, hi) in enumerate(LIMITS))
    inside = np.flatnonzero((place > np.array(LIMITS)[:, 0]).all(1) & (place < np.array(LIMITS)[:, 1]).all(1))
    wrong = [abs(score[k] - score_of(camera, excess, place[k])) for k in rng.choice(inside, 60, replace=False)]
    assert np.mean(np.array(wrong) < 0.05) > 0.85
    assert max(wrong) < 0.7  # a ray on the edge between two microlenses, or pixels, may go to either


def test_each_maximum_alone_is_returned(monkeypatch):
    camera = camera_of("hexagonal")
    truth = np.array([[0.1, -0.2, 1.2], [-0.3, 0.1, -1.5], [0.25, 0.3, 2.0]])
    excess = np.minimum(PointLights(camera)(truth).image(np.full(3, 4e4), 200 * 180), 20.0)
    place, score = PointLights(camera).places(excess, LIMITS)
    nearest = np.linalg.norm((place[:, None] - truth) / (0.02, 0.02, 0.15), axis=2).argmin(0)
    assert sorted(nearest) == [0, 1, 2]  # the three best are the three particles
    assert (np.abs(place[nearest] - truth) < (0.02, 0.02, 0.15)).all()
    away = np.linalg.norm(place[:, None, :2] - place[:, :2], axis=2)[np.triu_indices(len(place), 1)]
    assert away.min() > search.APART_PITCHES * 0.077
    thin = ((truth[0, 0] - 0.002, truth[0, 0] + 0.002), *LIMITS[1:])  # narrower than a step of places
    only, _ = PointLights(camera).places(excess, thin)
    assert np.abs(only[0] - truth[0]) == pytest.approx(0.0, abs=0.15)
    assert np.abs(only[:, 0] - truth[0, 0]).max() < 0.0021
    few = PointLights(camera).places(np.where(excess > 0.0, np.nan, excess), LIMITS)
    assert len(few[0]) == 0
    monkeypatch.setattr(search, "TOGETHER", 3)  # where planes are cut makes no difference
    for one, other in zip((place, score), PointLights(camera).places(excess, LIMITS), strict=True):
        np.testing.assert_array_equal(one, other)
