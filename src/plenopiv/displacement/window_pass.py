"""The windows of one pass: cut out of deformed volumes layer by layer, and transformed batch by batch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product

import numba
import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.agreement import agreement
from plenopiv.displacement.correlation import Gain, Spectra
from plenopiv.displacement.deformation import SPLINE_VARIANCE, DeformedPlanes
from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.peaks import find_peaks
from plenopiv.displacement.predictor import SplineField
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.uncertainty import ScatterCorrelator
from plenopiv.displacement.windows import WindowBatch, WindowGrid
from plenopiv.volume import Volume

_BATCH_VOXELS = 1 << 18  # windows of a batch and their spectra stay in a core's cache

StepDone = Callable[[int, int], None]


@dataclass(frozen=True)
class PassResult:
    """What one pass measured: ``displacement`` (3, nz, ny, nx) voxels, ``found`` and ``peak_ratio`` (nz, ny, nx).

    ``variance`` (3, nz, ny, nx), voxel^2: scatter of the particles of a window about its peak; None unless ``scatter``.
    ``between_pairs``, alike, of the windows over which sub-windows are averaged: scatter of their mean from pair to
    pair; None but of many pairs.
    """

    displacement: NDArray[np.float64]
    found: NDArray[np.bool_]
    peak_ratio: NDArray[np.float32]
    variance: NDArray[np.float64] | None = None
    between_pairs: NDArray[np.float64] | None = None


class PassVectors:
    """The peaks of a pass as they are found: ``moved`` (layers, windows of a layer, 3) x, y, z, ``found`` and
    ``ratio``. ``scattered`` (layers,): in which the ``variance`` (as ``moved``) of peaks is estimated, in none unless
    ``scatter`` (``scattered_layers``)."""

    def __init__(self, windows: WindowGrid, scatter: bool, settings: CorrelationSettings) -> None:
        nz, ny, nx = windows.shape
        self._windows = windows
        self.scattered = scattered_layers(windows, settings) & scatter
        self.variance = np.zeros((nz, ny * nx, 3))
        self.found = np.zeros((nz, ny * nx), bool)
        self.ratio = np.zeros((nz, ny * nx), np.float32)
        self.moved = np.zeros((nz, ny * nx, 3))

    def fit(
        self,
        layer: int,
        part: slice,
        correlation: NDArray[np.float32],
        gain: Gain,
        lit: NDArray[np.bool_],
        powers: NDArray[np.float64],
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Find the peaks of a batch of windows; ``place``, ``untilt`` and ``power`` of ``find_peaks``."""
        place, untilt, power = np.empty((len(lit), 3), np.int64), np.empty((len(lit), 3, 3)), np.empty((len(lit), 3))
        into = self.moved[layer, part], self.ratio[layer, part], self.found[layer, part]
        find_peaks(correlation, gain, *into, place, untilt, powers, power)
        self.found[layer, part] &= lit
        self.moved[layer, part][~lit] = 0.0
        self.ratio[layer, part][~lit] = 0.0
        return place, untilt, power

    def result(self, predictor: SplineField | None) -> PassResult:
        """What the pass measured; the variance of layers between scattered ones is the mean of theirs."""
        shape = self._windows.shape
        displacement, variance = (np.moveaxis(v.reshape(*shape, 3), -1, 0) for v in (self.moved, self.variance))
        if predictor is not None:
            displacement = displacement + predictor.at(*self._windows.centres)
        between = np.flatnonzero(~self.scattered)
        if self.scattered.any():
            variance[:, between] = (variance[:, between - 1] + variance[:, between + 1]) / 2
        found = displacement, self.found.reshape(shape), self.ratio.reshape(shape)
        return PassResult(*found, variance if self.scattered.any() else None)


def scattered_layers(windows: WindowGrid, settings: CorrelationSettings) -> NDArray[np.bool_]:
    """Layers (nz,) of windows in which the variance of peaks is estimated: all, but of sub-windows that share more than
    half of their planes with the next layer's every second one and the last."""
    layers = np.ones(windows.shape[0], bool)
    if settings.sub_window is not None and 2 * windows.step[0] < windows.size[0]:
        layers[1:-1:2] = False
    return layers


class WindowPass:
    """One pass over the windows of any number of pairs of volumes of ``shape``.

    ``windows``, ``predictor``, ``settings``, ``search``: as for ``multigrid.correlation_pass``. The ``count`` windows
    of a layer are numbered along x, then y; ``batches`` are ranges of them. ``radius``: of the search along z, y, x;
    ``corners`` (count, 2): first row and column of each window; ``cuts`` (layers, count, 3, 2): ``window_cuts``, None
    without a predictor; ``power``: of the weights by agreement; ``depth``: weights by depth, None if all are 1.
    """

    def __init__(
        self,
        windows: WindowGrid,
        predictor: SplineField | None,
        settings: CorrelationSettings,
        search: float,
        shape: tuple[int, int, int],
        depth: DepthWeights | None = None,
    ) -> None:
        size = windows.size
        self.windows, self.predictor, self.depth = windows, predictor, depth
        self.layers, rows, columns = windows.shape
        self.count = rows * columns
        batch = max(1, _BATCH_VOXELS // int(np.prod(size)))
        self.batches = [slice(lo, min(lo + batch, self.count)) for lo in range(0, self.count, batch)]
        self.radius = tuple(max(1, min(round(search * n), n // 2 - 2)) for n in size)
        done = 0.0 if predictor is None else SPLINE_VARIANCE
        variance = [max(sigma**2 - done, 0.0) for sigma in settings.smoothing[::-1]]
        about = variance, settings.whitening, settings.taper_voxels
        self.correlator = ScatterCorrelator(size, self.radius, *about)  # type: ignore[arg-type]
        self.corners = np.array(list(product(windows.starts[1].tolist(), windows.starts[2].tolist())))
        self.cuts = None
        if predictor is not None:
            self.cuts = window_cuts(windows, predictor, shape).reshape(self.layers, self.count, 3, 2)
        self.power = 0.0 if predictor is None else settings.agreement
        self._moved = np.zeros((self.layers, self.count))  # in depth, at the windows' centres
        if predictor is not None:
            self._moved = predictor.at(*windows.centres)[2].reshape(self._moved.shape)

    @property
    def plane(self) -> tuple[int, int, int]:
        """Values of a correlation along z, y, x."""
        z, y, x = (2 * r + 3 for r in self.radius)
        return z, y, x

    def gain(self, layer: int, part: slice) -> Gain:
        """As in the ``Spectra`` of these windows; the same for every pair."""
        return self.correlator.gain(None if self.cuts is None else self.cuts[layer, part])

    def depth_weights(self, layer: int, part: slice | NDArray[np.int64]) -> NDArray[np.float32] | None:
        """Of these windows (batch, nz), the same for every pair; None where all light counts alike."""
        if self.depth is None:
            return None
        size, corners = self.windows.size, self.corners[part]
        centres = corners + (np.array(size[1:]) - 1) / 2
        return self.depth.of_windows(int(self.windows.starts[0][layer]), size[0], centres, self._moved[layer, part])

    def each_batch(
        self,
        a: Volume,
        b: Volume,
        work: Callable[[int, slice, Spectra], None],
        layers: range | None = None,
        step_done: StepDone | None = None,
    ) -> None:
        """Call ``work(layer, part, spectra)`` for each batch of windows of ``layers`` (default all) of a pair, on
        several threads; ``step_done(done, total)`` after each layer. One layer of windows, and what the next one adds
        to it, is in memory at a time."""
        layers = range(self.layers) if layers is None else layers
        size, predictor = self.windows.size, self.predictor
        sources: tuple[Volume | DeformedPlanes, ...] = (a, b)
        if predictor is not None:
            rows = self.windows.rows(a.grid.shape[1])
            sources = DeformedPlanes(a, predictor, -0.5, rows), DeformedPlanes(b, predictor, 0.5, rows)

        with ThreadPoolExecutor(numba.get_num_threads()) as pool, ThreadPoolExecutor(1) as ahead:
            planes = zip(*(_planes(source, self.windows, layers, ahead) for source in sources), strict=True)
            for done, (layer, (planes_a, planes_b)) in enumerate(zip(layers, planes, strict=True), 1):

                def transform(part: slice, layer: int = layer, pa: NDArray = planes_a, pb: NDArray = planes_b) -> None:
                    corners, weights = self.corners[part], None
                    if self.power:
                        held = ([p[:, j : j + size[1], i : i + size[2]] for j, i in corners] for p in (pa, pb))
                        weights = agreement(*map(np.stack, held)) ** np.float32(self.power)
                    cuts = None if self.cuts is None else self.cuts[layer, part]
                    first, second = (WindowBatch.cut(planes, corners) for planes in (pa, pb))
                    by_depth = self.depth_weights(layer, part)
                    work(layer, part, self.correlator.spectra(first, second, cuts, weights, by_depth))

                list(pool.map(transform, self.batches))
                if step_done is not None:
                    step_done(done, len(layers))


def window_cuts(windows: WindowGrid, predictor: SplineField, shape: tuple[int, int, int]) -> NDArray[np.float64]:
    """Voxels (nz, ny, nx, 3, 2) that windows lose at their low and high ends along z, y, x.

    Samples at x -+ d/2 both come from a volume of ``shape`` where x stays |d|/2 away from its faces. d is taken where
    the window ends, the largest of nine points; at most a quarter of a window is cut.
    """
    places = []
    for start, n in zip(windows.starts, windows.size, strict=True):
        places.append((start[:, None] + np.array([0, n // 2, n - 1])).ravel())
    nz, ny, nx = windows.shape
    half = np.abs(predictor.at(*places)).reshape(3, nz, 3, ny, 3, nx, 3).transpose(0, 1, 3, 5, 2, 4, 6) / 2
    out = np.zeros((nz, ny, nx, 3, 2))
    for axis, (start, n, total) in enumerate(zip(windows.starts, windows.size, shape, strict=True)):
        ends = np.moveaxis(half[2 - axis], 3 + axis, 0)
        for side, (end, gap) in enumerate(((ends[0], start), (ends[2], total - n - start))):
            gap = gap.reshape([-1 if k == axis else 1 for k in range(3)])
            out[..., axis, side] = np.clip(end.max((-2, -1)) - gap, 0.0, n / 4)
    return out


def _planes(
    source: Volume | DeformedPlanes, windows: WindowGrid, layers: range, ahead: ThreadPoolExecutor
) -> Iterator[NDArray[np.float32]]:
    """The planes of each of ``layers`` of windows in turn. Planes that two layers share are made once; ``ahead``, which
    has one thread, makes the other planes of the next layer while one is correlated."""
    depth, step = windows.size[0], windows.step[0]
    starts = windows.starts[0][layers.start : layers.stop].tolist()
    first, kept = source.slab(starts[0], starts[0] + min(step, depth)), max(depth - step, 0)
    planes = np.empty((depth, *first.shape[1:]), np.float32)
    planes[: len(first)] = first
    del first
    for made in range(step, depth, step):
        planes[made : made + step] = source.slab(starts[0] + made, starts[0] + min(made + step, depth))
    for start in starts[1:]:
        coming = ahead.submit(source.slab, start + kept, start + depth)
        yield planes
        planes[:kept] = planes[depth - kept :].copy()
        planes[kept:] = coming.result()
    yield planes
