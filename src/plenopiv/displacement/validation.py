"""Validation: the normalised median test, and the replacement of outliers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError

_ITERATIONS = 3  # clustered outliers mask one another: each iteration tests against the vectors that the last accepted
FEWEST = 4  # accepted neighbours without which a vector is not tested
_AT_A_TIME = 20_000  # vectors of a volume tested at once
_NEIGHBOURS = 26  # vectors that a replacement is fitted to


def normalised_median(
    displacement: NDArray[np.float64], accepted: NDArray[np.bool_], floor: float
) -> NDArray[np.float64]:
    """Normalised median residual of every vector, Westerweel & Scarano (2005), Eq. 2, in 3D and free of trend.

    |d - median| / (median |d_i - median| + ``floor``) over the ``accepted`` ones of the 26 neighbours d_i, the largest
    of the three components. The trend is removed from the d_i first: axis by axis, the median difference between
    neighbours on the two sides extrapolates them to the vector's place. Without that, shear would reject vectors at the
    volume's faces, where all neighbours lie on one side, and curvature those at the crests of short waves.
    ``displacement``: (3, nz, ny, nx) voxels; ``accepted``: (nz, ny, nx). Returns (nz, ny, nx); inf with fewer than
    FEWEST accepted neighbours: extrapolated by their own differences, three neighbours agree whatever they are.
    Computed a few layers at a time.
    """
    nz = displacement.shape[1]
    layers = max(1, _AT_A_TIME // (displacement[0, 0].size or 1))
    out = np.empty(displacement.shape[1:])

    def test_layers(lo: int) -> None:
        first, last = max(lo - 1, 0), min(lo + layers + 1, nz)
        some = _residuals(displacement[:, first:last], accepted[first:last], floor)
        out[lo : lo + layers] = some[lo - first : lo - first + layers]

    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        list(pool.map(test_layers, range(0, nz, layers)))
    return out


def _residuals(displacement: NDArray[np.float64], accepted: NDArray[np.bool_], floor: float) -> NDArray[np.float64]:
    """``normalised_median`` of all layers at once, which takes 3 kB a vector."""
    _, nz, ny, nx = displacement.shape
    padded = np.pad(np.where(accepted, displacement, np.nan), ((0, 0), (1, 1), (1, 1), (1, 1)), constant_values=np.nan)
    # (3, 3, 3, component, nz, ny, nx): the neighbours at k, j, i - 1
    around = np.stack([padded[:, k : k + nz, j : j + ny, i : i + nx] for k, j, i in np.ndindex(3, 3, 3)])
    around = around.reshape(3, 3, 3, *displacement.shape)
    around[1, 1, 1] = np.nan
    trend = np.zeros_like(around)
    for axis in range(3):
        steps = np.moveaxis(np.diff(around, axis=axis), axis, 0).reshape(2, 9, *displacement.shape)
        before, after = (np.nan_to_num(_median(lines)) for lines in steps)
        along = np.moveaxis(trend, axis, 0)  # a view
        along[0] -= before
        along[2] += after
    around = (around - trend).reshape(-1, *displacement.shape)
    median = _median(around)
    spread = _median(np.abs(around - median))
    residual = (np.abs(displacement - median) / (spread + floor)).max(0)
    return np.where(np.isfinite(around[:, 0]).sum(0) >= FEWEST, residual, np.inf)


def _median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median of the finite values along the first axis; NaN where there are none."""
    ordered = np.sort(values, axis=0)  # NaN sorts last
    count = np.isfinite(values).sum(0, keepdims=True)
    lo, hi = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, values.shape[0] - 1)
    return 0.5 * (np.take_along_axis(ordered, lo, 0) + np.take_along_axis(ordered, hi, 0))[0]


def find_outliers(
    displacement: NDArray[np.float64], measured: NDArray[np.bool_], threshold: float, floor: float
) -> NDArray[np.bool_]:
    """Measured vectors (nz, ny, nx) that the normalised median test rejects.

    A vector with fewer than FEWEST measured neighbours cannot be tested and is kept. One that was rejected stays so
    where its neighbours are rejected too, until there are enough others to test it by.
    """
    accepted = measured
    for _ in range(_ITERATIONS):
        residual = normalised_median(displacement, accepted, floor)
        now = measured & np.where(np.isfinite(residual), residual <= threshold, accepted)
        if np.array_equal(now, accepted):
            break
        accepted = now
    return measured & ~accepted


def accepted(
    displacement: NDArray[np.float64],
    found: NDArray[np.bool_],
    settings: CorrelationSettings,
    closed: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Vectors (nz, ny, nx) that were ``found`` and are no outliers. ``closed``: windows (nz, ny, nx) in a solid body,
    which count as if they held no light."""
    measured = found if closed is None else found & ~closed
    return measured & ~find_outliers(displacement, measured, settings.outlier_threshold, settings.outlier_floor_voxels)


def replace_invalid(displacement: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """``displacement`` (3, nz, ny, nx) with vectors that are not ``valid`` (nz, ny, nx) replaced by a local linear fit.

    Least squares over the 26 nearest valid vectors (distance in vectors), each weighted by its inverse square distance.
    Linear fields are restored exactly, also at edges and in missing corners; along a direction in which the neighbours
    do not spread, the slope is zero. Raises ``PlenoPIVError`` when no vector is valid.
    """
    if not valid.any():
        raise PlenoPIVError(
            "correlation: not one window gave a displacement; check that both volumes hold particles"
            " and that correlation.windows is at least four times the displacement"
        )
    out = np.array(displacement, float)
    if valid.all():
        return out
    known, missing = np.argwhere(valid), np.argwhere(~valid)
    values = displacement[:, valid].T
    near = min(_NEIGHBOURS, len(known))
    distance, index = cKDTree(known).query(missing, k=[*range(1, near + 1)])
    for at, gap, which in zip(missing, distance, index, strict=True):
        weight = gap**-2.0
        weight /= weight.sum()
        centre, mean = weight @ known[which], weight @ values[which]
        root = np.sqrt(weight)[:, None]
        slope = np.linalg.lstsq(root * (known[which] - centre), root * (values[which] - mean), rcond=0.05)[0]
        out[:, *at] = mean + (at - centre) @ slope
    return out
