"""Reading and writing between a map's points, written in LLVM's terms, against plain sums."""

import numpy as np
import pytest

from plenopiv.kernels import kernel
from plenopiv.projection.plenoptic.plane_maps.interpolation import read_places, write_places
from plenopiv.projection.plenoptic.plane_maps.simd import LANES

WIDTH, LINES, OFFSET, BEGIN = 31, 9, 3, 5
FACTOR = np.float32(0.7)


@kernel
def read(values, places, image):
    at, across, along, share = places
    read_places(values, WIDTH, at, across, along, share, OFFSET, FACTOR, image, BEGIN)


@kernel
def write(image, places, values):
    at, across, along, share = places
    write_places(image, BEGIN, at, across, along, share, OFFSET, values, WIDTH)


def scene(points):
    """Random values, an image, and places at ``points`` behind OFFSET others that nothing may look at."""
    rng = np.random.default_rng(3)
    at = np.append(np.full(OFFSET, -(10**6)), points).astype(np.int32)
    ways = (rng.random(at.size).astype(np.float32) for _ in range(3))
    return rng.random(WIDTH * LINES).astype(np.float32), rng.random(20).astype(np.float32), (at, *ways)


def four_points(places):
    """Of each place (point, weight) four times."""
    for p, x, y, share in zip(*(column[OFFSET:].tolist() for column in places), strict=True):
        weights = (1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y
        yield [(p + step, share * w) for step, w in zip((0, 1, WIDTH, WIDTH + 1), weights, strict=True)]


# apart, all at one, in neighbours that share points, and at both ends of the map
layouts = pytest.mark.parametrize(
    "points",
    [
        np.arange(LANES) * 17 + 4,
        np.full(LANES, 40),
        np.arange(LANES) + 60,
        60 - np.arange(LANES),
        [0, WIDTH * (LINES - 1) - 2, 0, 1, WIDTH, WIDTH + 1, 2 * WIDTH - 1, WIDTH * (LINES - 1) - 2],
    ],
)


@layouts
def test_reading(points):
    values, image, places = scene(points)
    want = image.astype(float)
    for n, terms in enumerate(four_points(places)):
        want[BEGIN + n] += FACTOR * sum(w * values[p] for p, w in terms)
    read(values, places, image)
    np.testing.assert_allclose(image, want, rtol=1e-6)


@layouts
def test_writing(points):
    values, image, places = scene(points)
    want = values.astype(float)
    for n, terms in enumerate(four_points(places)):
        for p, w in terms:
            want[p] += w * image[BEGIN + n]
    write(image, places, values)
    np.testing.assert_allclose(values, want, rtol=2e-6)
