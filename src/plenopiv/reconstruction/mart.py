"""MART, a few views at a time (paper, section 3; Elsinga et al. 2006, Eq. 3).

MART multiplies each voxel by (I / (w E))^(mu w) for one pixel after the other. The pixels of one *view* look through
one portion of the main lens, and a voxel's light in a view reaches only the microlenses around one point. Where it
reaches a single microlens, no two pixels of the view share a voxel, and correcting all of them at once is exactly
pixel-by-pixel MART. Where the light is split among neighbours, the voxel takes the weighted mean of their corrections,

    E <- E (1 + sum_S w_S ((I_S / P_S)^mu - 1)),      sum_S w_S <= 1,

the arithmetic form of the product of powers; like it, it leaves E alone where P = I, and it keeps E >= 0.

The corrections of a few views whose exponents mu sum to no more than two are added and applied at once. That the second
view would have seen the volume a little better after the first makes no difference that can be measured (beyond two,
where a relaxed iteration no longer converges, it does), and voxels are spread into maps and gathered once for all of
them.

Of several pinhole cameras around a volume (Tomo-PIV) each is a view.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.protocol import Projection
from plenopiv.reconstruction.thinning import keeping
from plenopiv.volume import SparseVolume

THIN_EVERY = 16  # views
TOGETHER = 8  # views that correct the volume at once, at most

Progress = Callable[[int, int], None]


def mart(
    values: NDArray[np.float32],
    projection: Projection,
    volume: SparseVolume,
    *,
    iterations: int,
    relaxation: float,
    floor: float | NDArray[np.float32] = 1.0,
    thin: float = 0.0,
    saturated: NDArray[np.bool_] | None = None,
    seed: int = 0,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> tuple[SparseVolume, list[float]]:
    """The volume, among the voxels of ``volume``, whose views are ``values`` (view, pixel), in counts.

    ``floor`` (counts, the dark noise; one number or (view, pixel)) is added to measured and projected light, so that a
    pixel's noise does not empty a voxel. ``saturated`` (view, pixel): values that are only the least that the pixel
    collected; they add light where it is missing and take none away. Views are used in a new random order in each
    iteration, as neighbours are nearly redundant, and as many at once as their exponents allow, TOGETHER at most. The
    first iteration, which has to find where light is, takes twice the exponent ``relaxation``. Every few views voxels
    that hold no more than ``thin`` of the mean are left out: less of it during the first iteration, in proportion to
    the views already used, and none in the last of several, which distributes their light. ``overwrite``: work in the
    memory of ``volume``, which is of no use afterwards. Returns the volume and, for each iteration, the RMS residual in
    counts, each view's before it was corrected.
    """
    seen = projection.seen
    floors = np.asarray(floor, np.float32)
    measured = np.maximum(values, 0.0) + floors
    rng = np.random.default_rng(seed)
    residuals = []
    working = volume if overwrite else keeping(volume, np.ones(volume.values.size, bool))
    for done in range(iterations):
        squares, power = 0.0, min(relaxation * (2 if done == 0 else 1), 1.0)
        together = min(TOGETHER, int(2 / power + 1e-6)) if power < 1 else 1
        order, used = rng.permutation(projection.views), 0
        while used < order.size:
            views = order[used : used + together]
            light = np.maximum(projection.forward(views, working), 0.0)  # outer products may leave a little less
            ratio = measured[views] / (light + (floors[views] if floors.ndim else floors))
            missing = (values[views] - light) * seen[views]
            if saturated is not None:  # more light than they show contradicts nothing
                full = saturated[views]
                ratio[full] = np.maximum(ratio[full], 1)
                missing[full] = np.maximum(missing[full], 0)
            squares += float(np.sum(missing**2, dtype=np.float64))
            projection.multiply(views, np.where(seen[views], ratio**power - 1.0, 0.0), working)
            before, used = used, used + views.size
            if used // THIN_EVERY > before // THIN_EVERY and done < max(iterations - 1, 1):
                share = thin * min(done + used / order.size, 1.0)
                least = share * float(working.values.mean(dtype=np.float64))
                working = keeping(working, working.values > least, overwrite=True)
            if progress:
                progress(done * order.size + used, iterations * order.size)
        residuals.append((squares / max(int(seen.sum()), 1)) ** 0.5)
    return keeping(working, working.values > 0), residuals
