"""A row of voxels line by line is the same row voxel by voxel."""

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.plane_maps.maps import outer_products
from plenopiv.projection.plenoptic.plane_maps.voxel_rows import (
    first_map_row,
    separable_is_cheaper,
    spread_rows,
    sum_rows,
)
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import VoxelGrid

NX = 90


@pytest.fixture(scope="module", params=["square", "hexagonal"])
def maps(request):
    where = layout(small_camera(request.param))
    grid = VoxelGrid.covering((-0.7, 0.7), (-0.2, 0.2), (-3.0, 3.0), (1.4 / NX, 0.017, 0.25))
    return PlenopticProjector(where, grid).images.maps


def planes_with(maps):
    """Planes of every number of points to a voxel and voxels to a point that have outer products: hexagons in focus are
    made of too many."""
    found = {(points, shift): k for k, (*_, points, shift) in enumerate(maps.shape.tolist()) if maps.rank[k]}
    assert len(found) >= 2
    return found.values()


def own(maps, k, rank):
    return maps.weights[maps.start[k, 0] :], maps.factors[maps.start[k, 1] :], rank


def row(maps, k, j, listed, rng):
    """Row j of a plane: its place in the list, columns and values; a strip high enough for it that begins with the
    first row of the map that it reaches, and spare lines."""
    row_start = np.zeros(j + 2, np.int64)
    row_start[-1] = listed
    column = np.sort(rng.choice(NX, listed, replace=False)).astype(np.uint16)
    _, width, rows, *_ = maps.shape[k]
    spare = np.empty((1 + (1 << maps.shape[:, 5].max()), maps.shape[:, 1].max()), np.float32)
    where = j, j + 1, first_map_row(maps.shape[k], j), row_start, column
    return where, rng.random(listed).astype(np.float32), rng.random((rows + 3) * width).astype(np.float32), spare


@pytest.mark.parametrize("j", [0, 1, 3])
def test_spread(maps, j):
    rng = np.random.default_rng(j)
    for k in planes_with(maps):
        where, values, strip, spare = row(maps, k, j, NX - 4, rng)
        slow = strip.copy()
        spread_rows(own(maps, k, maps.rank[k]), tuple(maps.shape[k]), *where, values, strip, spare)
        spread_rows(own(maps, k, 0), tuple(maps.shape[k]), *where, values, slow, spare)
        assert np.abs(strip - slow).max() < 1.5e-3 * np.abs(slow).max()


@pytest.mark.parametrize("multiply", [0, 4])
def test_sum(maps, multiply):
    rng = np.random.default_rng(multiply)
    for k in planes_with(maps):
        where, values, strip, spare = row(maps, k, 2, NX - 4, rng)
        fast, slow = values.copy(), values.copy()
        for out, rank in ((fast, maps.rank[k]), (slow, 0)):
            about = own(maps, k, rank), tuple(maps.shape[k]), *where
            sum_rows(*about, strip - np.float32(0.5), spare, multiply, out)
        np.testing.assert_allclose(fast, slow, atol=1.5e-3 * np.abs(slow).max())


def test_few_voxels_are_spread_one_by_one(maps):
    for k in planes_with(maps):
        assert not separable_is_cheaper(maps.shape[k], maps.rank[k], 1)
        assert not separable_is_cheaper(maps.shape[k], 0, NX)


def test_outer_products_of_shares_without_any_are_none():
    noise = np.random.default_rng(0).random((2, 2, 12, 16)).astype(np.float32)
    assert outer_products(noise) == []


def test_outer_products_add_up():
    rng = np.random.default_rng(1)
    down, across = rng.random((2, 2, 8)), rng.random((2, 2, 16))  # of two parts, for two voxels to a point
    shares = np.einsum("pyr,pxc->yxrc", down, across).astype(np.float32)
    parts = outer_products(shares)
    assert len(parts) == 2
    columns, rows = [p[:16].reshape(2, 8) for p in parts], [p[16:].reshape(2, 16) for p in parts]
    again = sum(np.einsum("yr,xc->yxrc", d, a) for d, a in zip(columns, rows, strict=True))
    np.testing.assert_allclose(again, shares, rtol=1e-3)
