"""What particles show of a calibration that is a little wrong, and what they cannot show."""

import numpy as np
import pytest

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.space_map import ViewShift
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.tracking.light import PointLights, prior_std_mm
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.ray_shifts import DEGREE, VISIBLE, RayShifts, by_shifts, visible_terms
from plenopiv.tracking.refine import Prior, refine
from plenopiv.tracking.with_calibration import step

CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.004, (0.011, -0.023)),
    0.308,
    Sensor(420, 380, 0.0055, 12, 60),
)
RADIUS, HALF = 12.5, 0.5 * 420 * 0.0055
LIGHT = 4e4


def strewn(count=160, seed=1):
    """Particles away from the dead zone (n, 3) mm."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.8, 3.0, count) * rng.choice([-1, 1], count)
    return np.column_stack([rng.uniform(-0.8, 0.8, count), rng.uniform(-0.7, 0.7, count), z])


def seen(position, left, noise=2.0, seed=2):
    """Pixels of particles whose rays fall beside by ``left``."""
    lights, shape = PointLights(CAMERA, left=left)(position), CAMERA.sensor.rows * CAMERA.sensor.columns
    counts = LIGHT * np.bincount(lights.pixel, lights.share, shape)
    counts = counts + np.random.default_rng(seed).normal(0.0, np.sqrt(noise**2 + 0.5 * counts))
    return Pixels(counts, np.ones(shape, bool), noise**2, 0.5)


def shift_of(*terms):
    """A shift of ``terms`` ((a, b, c, d), ds um, dt um)."""
    every = [
        (a, b, c, d)
        for a in range(DEGREE + 1)
        for b in range(DEGREE + 1)
        for c in range(DEGREE + 1)
        for d in range(DEGREE + 1)
        if a + b + c + d <= DEGREE
    ]
    found = dict.fromkeys(every, (0.0, 0.0)) | {p: (1e-3 * ds, 1e-3 * dt) for p, ds, dt in terms}
    return ViewShift(RADIUS, HALF, DEGREE, tuple(found[p] for p in every))


def rays(position):
    """Places u, s (n, places, 2) of the rays of points, by the thin lens' own formula."""
    angle = 2 * np.pi * np.arange(40) / 1.618
    u = RADIUS * np.sqrt((np.arange(40) + 0.5) / 40)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    distance = 100.0 - position[:, 2]  # from the main lens: object and image distance are 100 mm
    spread, scale = 1 + 100.0 / distance - 100.0 / 50.0, -100.0 / distance
    return u, spread[:, None, None] * u + (scale[:, None] * position[:, :2])[:, None]


def left_by_points(shift, position):
    """RMS (um) of a shift over rays, and of what is left of it once each point has moved as it likes (least squares,
    point by point)."""
    u, s = rays(position)
    all_of_it, left = [], []
    for place in s:
        off = 1e3 * shift(u, place)
        ones, none = np.ones(len(u)), np.zeros(len(u))
        moves = np.stack([np.r_[ones, none], np.r_[none, ones], u.T.ravel()], 1)
        flat = off.T.ravel()
        rest = flat - moves @ np.linalg.lstsq(moves, flat, rcond=None)[0]
        all_of_it.append(np.sum(flat**2) / len(u))
        left.append(np.sum(rest**2) / len(u))
    return np.sqrt(np.mean(all_of_it)), np.sqrt(np.mean(left))


def test_what_is_fitted_is_seen_by_the_views_and_of_one_micrometre():
    position = strewn()
    terms = visible_terms(CAMERA, position)
    count = terms.visible.shape[1]
    assert count + terms.hidden == 70
    for k in (0, count // 2, count - 1):
        whole, left = left_by_points(terms.shift(np.eye(count)[k]), position)
        assert whole == pytest.approx(1.0, rel=0.1)
        assert left**2 > 0.8 * VISIBLE * whole**2


@pytest.mark.parametrize(
    "hidden",
    [
        [((0, 0, 0, 0), 1.0, 0.0)],  # all of it shifted
        [((0, 0, 0, 0), 0.0, 1.0)],
        [((0, 0, 1, 0), 1.0, 0.0), ((0, 0, 0, 1), 0.0, 1.0)],  # a scale
        [((1, 0, 0, 0), 1.0, 0.0), ((0, 1, 0, 0), 0.0, 1.0)],  # a shift of depth
    ],
)
def test_displacements_of_all_that_is_seen_are_not_fitted(hidden):
    position = strewn()
    terms, shift = visible_terms(CAMERA, position), shift_of(*hidden)
    assert left_by_points(shift, position)[1] < 0.03
    u, s = rays(position)
    u, s = np.tile(u, (len(s), 1)), s.reshape(-1, 2)
    values = terms.values(u, s)
    fitted = np.concatenate([values @ terms.visible[: values.shape[1]], values @ terms.visible[values.shape[1] :]])
    wanted = 1e3 * shift(u, s).T.ravel()
    rest = wanted - fitted @ np.linalg.lstsq(fitted, wanted, rcond=None)[0]
    assert np.sum(rest**2) > 0.9 * np.sum(wanted**2)


def test_changes_of_pixels_are_those_of_exact_light():
    """By differences, one particle at a time."""
    for position in strewn(6):
        at = position[None]
        terms = visible_terms(CAMERA, strewn())
        pixels = seen(at, None, 0.5)
        fit = refine(PointLights(CAMERA), pixels, at, np.array([LIGHT]), Prior(at, prior_std_mm(CAMERA)), 0)
        lit, slopes = by_shifts(CAMERA, terms, fit, np.ones(pixels.counts.size))
        count, all_found, all_expected = terms.visible.shape[1], [], []
        for k in range(0, count, 9):
            images = []
            for sign in (1.0, -1.0):
                lights = PointLights(CAMERA, left=terms.shift(sign * np.eye(count)[k]))(at)
                images.append(LIGHT * np.bincount(lights.pixel, lights.share, pixels.counts.size))
            expected = (images[0] - images[1]) / 2
            found = np.zeros(expected.size)
            found[lit] = slopes[:, k]
            # the light of a pixel is not all at its middle, which is a seventh of the aperture wide
            assert found @ expected / (expected @ expected) == pytest.approx(1.0, abs=0.2)
            assert np.linalg.norm(found - expected) < 0.6 * np.linalg.norm(expected)
            all_found.append(found)
            all_expected.append(expected)
        assert np.vdot(all_found, all_expected) / np.vdot(all_expected, all_expected) == pytest.approx(1.0, abs=0.06)


@pytest.mark.full
@pytest.mark.parametrize(
    "true",
    [
        shift_of(((2, 0, 0, 0), 4.0, 0.0)),
        shift_of(((2, 0, 0, 0), 0.0, 4.0)),
        shift_of(((0, 1, 0, 0), -3.0, 0.0)),
        shift_of(
            ((3, 0, 0, 0), 8.0, 0.0), ((1, 2, 0, 0), 8.0, 0.0), ((2, 1, 0, 0), 0.0, 8.0), ((0, 3, 0, 0), 0.0, 8.0)
        ),
        shift_of(((2, 0, 1, 0), 8.0, 4.0)),
    ],
)
def test_a_shift_of_views_is_found_with_the_particles(true):
    position = strewn()
    terms = visible_terms(CAMERA, position)
    pixels = seen(position, true)
    rng = np.random.default_rng(3)
    start = position + rng.normal(size=position.shape) * [0.002, 0.002, 0.02]
    light, prior = np.full(len(position), LIGHT), Prior(start, prior_std_mm(CAMERA))
    amounts, at = np.zeros(terms.visible.shape[1]), start
    for _ in range(3):
        found = step(RayShifts(CAMERA, terms), pixels, at, light, prior, amounts, 2)
        at, light, amounts = found.position_mm, found.light, found.amounts
    before = left_by_points(true, position)[1]
    minus = ViewShift(RADIUS, HALF, DEGREE, tuple((-a, -b) for a, b in terms.shift(amounts).coefficients_mm))
    after = left_by_points(minus.plus(true), position)[1]
    assert before > 0.8
    assert after < 0.25 * before
    assert found.chi2 == pytest.approx(1.0, abs=0.1)


@pytest.mark.full
def test_of_a_right_calibration_little_is_found_and_its_error_is_stated():
    position = strewn()
    terms, pixels = visible_terms(CAMERA, position), seen(position, None)
    prior = Prior(position, prior_std_mm(CAMERA))
    amounts = np.zeros(terms.visible.shape[1])
    found = step(RayShifts(CAMERA, terms), pixels, position, np.full(len(position), LIGHT), prior, amounts, 2)
    assert found.rms < 2.5 * found.std < 0.5


def test_shifts_add():
    rng = np.random.default_rng(4)
    one = ViewShift(10.0, 2.0, 2, tuple(map(tuple, rng.normal(size=(15, 2)))))
    other = ViewShift(12.5, 3.0, 3, tuple(map(tuple, rng.normal(size=(35, 2)))))
    u, s = rng.uniform(-10, 10, (20, 2)), rng.uniform(-2, 2, (20, 2))
    np.testing.assert_allclose(one.plus(other)(u, s), one(u, s) + other(u, s), atol=1e-12)
    np.testing.assert_allclose(other.plus(one)(u, s), one(u, s) + other(u, s), atol=1e-12)
