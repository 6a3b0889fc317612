"""MART and its relatives as plain generators: each yields the volume after one more iteration over all pixels.

All take the same things: ``values`` (view, lens) in counts, a projector, a sparse volume to start from, the exponent
``relaxation`` of each iteration (the last one goes on), and ``floor`` in counts, added to measured and
to projected light. Nothing is left out between iterations: the list of voxels stays that of the start.

With w_S the share of a pixel S that a voxel lights (at most 1), I_S and P_S its measured and projected counts:

    view-sequential, sums      E <- E (1 + sum_S w_S ((I_S/P_S)^mu - 1))   one view after the other (the library's)
    view-sequential, powers    E <- E prod_S (I_S/P_S)^(mu w_S)            one view after the other
    pixel-sequential           E <- E (I_S/P_S)^(mu w_S)                   one pixel after the other: the paper's MART
    simultaneous, powers       E <- E prod_S (I_S/P_S)^(mu w_S / sum w)    all pixels at once: SMART
    simultaneous, sums         E <- E sum_S w_S (I_S/P_S)^mu / sum w       all pixels at once; mu = 1 is ML-EM
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from plenopiv.lightfield import LightField
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.thinning import keeping
from plenopiv.volume import SparseVolume

Array = NDArray[np.float32]
Order = Callable[[PlenopticProjector, int], NDArray[np.int64]]  # of the views in iteration k
Form = Literal["sums", "powers"]


def random_order(seed: int = 0) -> Order:
    """Another random order in each iteration; the same as the library's for the same seed."""
    rng = np.random.default_rng(seed)
    return lambda projector, _: rng.permutation(projector.views)


def one_random_order(projector: PlenopticProjector, _: int) -> NDArray[np.int64]:
    """The same random order in all iterations."""
    return np.random.default_rng(0).permutation(projector.views)


def raster_order(projector: PlenopticProjector, _: int) -> NDArray[np.int64]:
    """Row by row over the aperture: neighbours follow each other."""
    return np.arange(projector.views)


def rim_first(projector: PlenopticProjector, _: int) -> NDArray[np.int64]:
    """From the rim of the aperture inwards."""
    return np.argsort(-np.hypot(*projector.layout.offsets.T), kind="stable")


def golden_order(projector: PlenopticProjector, k: int) -> NDArray[np.int64]:
    """Raster order in steps of the golden section of all views: successive views lie far apart."""
    n = projector.views
    step = next(s for s in count(round(n * (5**0.5 - 1) / 2)) if np.gcd(s, n) == 1)
    return (np.arange(n) * step + k * (n // 3)) % n


def half_of_the_views(seed: int = 0) -> Order:
    """A random half of the views in each iteration."""
    rng = np.random.default_rng(seed)
    return lambda projector, _: rng.permutation(projector.views)[: projector.views // 2]


def of_round(relaxation: tuple[float, ...], k: int) -> float:
    """Exponent of iteration ``k``."""
    return relaxation[min(k, len(relaxation) - 1)]


def ratios(
    view: int | NDArray[np.int64], values: Array, projector: PlenopticProjector, volume: SparseVolume, floor: float
) -> Array:
    """Measured over projected light of one view, (lens,), or of several."""
    f = np.float32(floor)
    return (np.maximum(values[view], 0.0) + f) / (projector.forward(view, volume) + f)


def view_sequential(
    values: Array,
    projector: PlenopticProjector,
    volume: SparseVolume,
    *,
    relaxation: tuple[float, ...] = (0.3,),
    floor: float = 1.0,
    order: Order | None = None,
    form: Form = "sums",
    together: int = 1,
) -> Iterator[SparseVolume]:
    """All pixels of a view at once, or of ``together`` views, one after the other."""
    order = order or random_order()
    seen = projector.layout.seen
    volume = volume.with_values(volume.values.copy())
    for k in count():
        mu = of_round(relaxation, k)
        views = order(projector, k)
        for some in np.split(views, range(together, views.size, together)):
            ratio = ratios(some, values, projector, volume, floor)
            if form == "sums":
                projector.multiply(some, np.where(seen[some], ratio**mu - 1.0, 0.0), volume)
            else:
                volume.values[:] *= np.exp(mu * projector.gather(some, np.log(ratio), volume))
        yield volume.with_values(volume.values.copy())


def simultaneous(
    values: Array,
    projector: PlenopticProjector,
    volume: SparseVolume,
    *,
    relaxation: tuple[float, ...] = (1.0,),
    floor: float = 1.0,
    form: Form = "powers",
) -> Iterator[SparseVolume]:
    """All pixels of all views at once, each voxel by the mean over the pixels that it lights."""
    ones = np.ones(projector.layout.lenses, np.float32)
    pixels = np.maximum(sum(projector.gather(v, ones, volume) for v in range(projector.views)), np.float32(1e-3))
    for k in count():
        mu, total = of_round(relaxation, k), np.zeros(volume.values.size, np.float32)
        for view in range(projector.views):
            ratio = ratios(view, values, projector, volume, floor)
            total += projector.gather(view, np.log(ratio) if form == "powers" else ratio**mu, volume)
        factor = np.exp(mu * total / pixels) if form == "powers" else total / pixels
        volume = volume.with_values(volume.values * factor)
        yield volume


def dark_noise(field: LightField) -> float:
    """Standard deviation in counts of pixels without light, from the values below the black level (half a normal)."""
    below = field.values[field.layout.seen & (field.values < 0)].astype(np.float64)
    return float(np.sqrt(np.mean(below**2))) if below.size else 0.0


def lit_threshold(field: LightField) -> float:
    """Counts above which a pixel is lit: three times the dark noise, 3 % of what bright pixels hold, 1 at least."""
    bright = float(np.percentile(field.values[field.layout.seen], 90))
    return max(3.0 * dark_noise(field), 0.03 * bright, 1.0)


def candidates(values: Array, projector: PlenopticProjector, threshold: float, tolerance_px: float) -> SparseVolume:
    """The voxels of whose light no more than ``tolerance_px`` pixels' worth falls on pixels of ``threshold`` counts or
    less: the rule of docs/decisions/0005, the same for all variants."""
    volume = projector.every_voxel()
    volume.values[:] = 0.0  # pixels' worth of light on dark pixels, so far
    dark = np.where(values > threshold, 0.0, 1.0).astype(np.float32)
    for view in rim_first(projector, 0):
        volume.values[:] += projector.gather(view, dark[view], volume)
        volume = keeping(volume, volume.values <= tolerance_px)
    return volume


def uniform_start(values: Array, _: PlenopticProjector, listed: SparseVolume) -> SparseVolume:
    """All light shared evenly among the listed voxels."""
    return listed.with_values(np.full(listed.values.size, total_light(values) / listed.values.size, np.float32))


def first_guess(
    values: Array, projector: PlenopticProjector, listed: SparseVolume, floor: float, mean: str, power: float = 1.0
) -> SparseVolume:
    """What the views have in common at a voxel, raised to ``power``; in all as much light as was measured.

    A view says the mean of the pixels that the voxel lights in it, weighted by their shares. Over the views:
    ``mean = "product"`` takes the geometric mean (the multiplicative first guess of Worth & Nickels 2008), "least" the
    smallest, which bounds what the voxel can hold.
    """
    ones = np.ones(projector.layout.lenses, np.float32)
    said = np.zeros(listed.values.size, np.float32) if mean == "product" else np.full(listed.values.size, np.inf)
    views = np.zeros(listed.values.size, np.float32)
    for view in range(projector.views):
        pixels = projector.gather(view, ones, listed)
        light = projector.gather(view, np.maximum(values[view], 0.0), listed) / np.maximum(pixels, 1e-6) + floor
        known = pixels > 0.1
        if mean == "product":
            said += np.where(known, np.log(light), 0.0)
            views += known
        else:
            said = np.where(known, np.minimum(said, np.log(light)), said)
    logarithm = power * np.where(np.isfinite(said), said / np.maximum(views, 1.0) if mean == "product" else said, 0.0)
    guess = np.exp(logarithm - logarithm.max())
    return listed.with_values((guess * (total_light(values) / guess.sum())).astype(np.float32))


def total_light(values: Array) -> float:
    """Counts of all pixels, at least 1."""
    return max(float(values.sum(dtype=np.float64)), 1.0)


def residual(values: Array, projector: PlenopticProjector, volume: SparseVolume) -> float:
    """RMS in counts of what the volume leaves unexplained in the seen pixels."""
    seen, squares = projector.layout.seen, 0.0
    for view in range(projector.views):
        missing = np.where(seen[view], values[view] - projector.forward(view, volume), 0.0)
        squares += float(np.sum(missing**2, dtype=np.float64))
    return (squares / int(seen.sum())) ** 0.5
