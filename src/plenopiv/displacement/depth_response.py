"""How much of a displacement in depth one pass finds where particles are long, measured.

The ends of a window cut particle images that are long in depth, which pulls their peak to no displacement. ``overlap``
corrects for it, twofold at most. What that leaves a peak does not show: it is measured. A sample of the last pass'
windows is deformed once more, by half a voxel in depth beyond the predictor. Of that half voxel the windows find a part
r; the rest stays between their vectors and those of the last pass.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.pairs import Pairs
from plenopiv.displacement.predictor import SplineField
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.window_pass import PassResult
from plenopiv.displacement.windows import WindowGrid

OFFSET = 0.5  # voxel
ACROSS = 6  # windows along y and x, at most; along z as far apart as they are deep, or nearer
LEAST = 0.2  # r that is taken at least: of a smaller one noise is all


def depth_response(
    pairs: Pairs,
    windows: WindowGrid,
    predictor: SplineField,
    settings: CorrelationSettings,
    last: PassResult,
    closed: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """r (nz,) of each layer of ``windows``, LEAST to 1: the median of a layer's sample, linear between these. ``last``:
    what the last pass, deformed by ``predictor``, found in them; ``closed`` (nz, ny, nx): windows in a solid body."""
    (z, y, x), sample = _sampled(windows), sample_of(windows)
    starts = sample.starts
    beyond = pairs.correlated(sample, _moved(predictor, OFFSET), settings, settings.residual_search)
    gap = (beyond.displacement[2] - last.displacement[2, z, y, x]) / OFFSET
    free = True if closed is None else ~closed[z, y, x]
    left = np.where(beyond.found & last.found[z, y, x] & free, gap, np.nan).reshape(len(starts[0]), -1)
    measured = np.isfinite(left).any(1)
    if not measured.any():
        return np.ones(windows.shape[0])
    found = 1 - np.nanmedian(left[measured], 1)
    return np.clip(np.interp(windows.starts[0], starts[0][measured], found), LEAST, 1.0)


def sample_of(windows: WindowGrid) -> WindowGrid:
    """The windows in which r is measured."""
    some = _sampled(windows)
    starts = tuple(begin[each] for begin, each in zip(windows.starts, some, strict=True))
    steps = tuple(step * each.step for step, each in zip(windows.step, some, strict=True))
    return WindowGrid(windows.size, steps, starts)  # type: ignore[arg-type]


def _sampled(windows: WindowGrid) -> tuple[slice, slice, slice]:
    """Which of them, along z, y, x."""
    apart = (max(1, windows.size[0] // windows.step[0]), *(max(1, -(-count // ACROSS)) for count in windows.shape[1:]))
    z, y, x = (slice((count - 1) % n // 2, None, n) for count, n in zip(windows.shape, apart, strict=True))
    return z, y, x


def _moved(predictor: SplineField, by: float) -> SplineField:
    """The predictor and ``by`` voxels in depth: B-splines sum to one."""
    coefficients = predictor.coefficients.copy()
    coefficients[2] += np.float32(by)
    return replace(predictor, coefficients=coefficients)
