"""Light of points whose rays fall beside those of a thin lens, as spherical aberration makes them: against rays."""

import numpy as np
import pytest
from particle_scenes import CAMERA

from plenopiv.cameras.ray_model import on_disc
from plenopiv.cameras.space_map import ViewShift
from plenopiv.tracking.light import PointLights

RADIUS_MM = 0.5 * CAMERA.main_lens.aperture_mm
MOST_MM = 0.25 * CAMERA.lattice.pitch_mm  # at the aperture's edge


@pytest.fixture(scope="module")
def left():
    """Spherical aberration along s, and twice as much along t, from the same places all over the array."""
    rng = np.random.default_rng(1)
    u, s = rng.uniform(-RADIUS_MM, RADIUS_MM, (3000, 2)), rng.uniform(-0.6, 0.6, (3000, 2))
    beside = MOST_MM * (u / RADIUS_MM) * ((u / RADIUS_MM) ** 2).sum(1, keepdims=True) * (0.5, 1.0)
    return ViewShift.fitted(u, s, beside)


def by_rays(point, left, rays=300_000):
    """Share of a point's light in each pixel (rows * columns,), ray by ray."""
    camera, sensor, e = CAMERA, CAMERA.sensor, CAMERA.image_scale
    u = on_disc(RADIUS_MM, rays)
    s = camera.spread(point[2]) * u + camera.scale(point[2]) * np.asarray(point[:2])
    s = s + left(u, s)
    lens = np.stack(camera.lattice.centres(*camera.lattice.nearest(*s.T)), -1)
    at = (lens * (1 + e) - e * (u - s + lens)) / sensor.pixel_pitch_mm
    column0, row0 = sensor.axis
    pixel = np.rint(row0 + at[:, 1]) * sensor.columns + np.rint(column0 - at[:, 0])
    return np.bincount(pixel.astype(int), minlength=sensor.rows * sensor.columns) / rays


@pytest.mark.parametrize(
    "point",
    [(0.05, -0.08, 1.7), *(pytest.param(p, marks=pytest.mark.full) for p in [(-0.1, 0.04, -2.4), (0.02, 0.03, -0.9)])],
)
def test_shares_are_those_of_rays(left, point):
    true = by_rays(point, left)

    def missed(lights):
        share = np.bincount(lights.pixel, lights.share, len(true))
        return 0.5 * np.abs(share - true).sum()

    thin = missed(PointLights(CAMERA, 0.0)([point]))
    beside = missed(PointLights(CAMERA, 0.0, left)([point]))
    assert thin > 0.08
    assert beside < 0.03
