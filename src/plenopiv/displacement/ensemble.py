"""Ensemble correlation: one displacement field from many pairs of volumes of the same flow.

In each pass the correlation of each window is summed over all pairs before its peak is looked for (Meinhart, Wereley &
Santiago 2000, J. Fluids Eng. 122 285; Delnoij et al. 1999, Chem. Eng. Sci. 54 5159). What particles that pair by chance
add differs from pair to pair, and the peak of those that move with the flow grows with the number of pairs: seeding may
be so thin that a window of one pair holds a particle or two. The flow must be steady, or the pairs of one phase; what
is found is where the displacements of all particles of a window are most frequent.

*Sums.* Numerator and overlap are summed apart. The overlap C(d) of ``correlation`` is that of the windows' weights, the
same for every pair, so the sum of R(d) is divided by it once. In discrete window offset the energy of the second
window differs from pair to pair, and is summed for itself (``summed_offset``). Whitening is each pair's own.

*Weights.* R grows with the light of a pair. Each volume is therefore scaled so that its brightness, sum v^2 / sum v
over its voxels, is that of the first pair's. A mean over voxels would be lower in a pair with fewer particles and raise
what it adds; this quotient depends on the particles that are there, not on how many there are. Within a window, a pair
counts by the number of its particles.

*Standard deviation.* Errors of particles are independent between blocks of a window and between pairs. What a pair has
of its own (a flow that fluctuates) is common to all its blocks; what a place has of its own (a gradient that
deformation has left) is common to all pairs. The jackknife variance over blocks, summed over pairs, has the last, that
over pairs the other, and both have the particles'. With the variance over blocks of single pairs, which has these
alone,

    s^2 = V(blocks) + max(V(pairs) - V(blocks of pairs), 0)

(errors clustered two ways: Cameron, Gelbach & Miller 2011, J. Bus. Econ. Stat. 29 238). For one pair it is V(blocks),
as for ``measure``. Iteration and averaging bias follow as there (``uncertainty``). Of means over sub-windows, which
share what a pair has of its own, each pair's part in the mean is summed, and V(pairs) is that of the mean
(``PartsOfPairs``): the larger of it and what V(blocks) makes of the mean is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, Protocol, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.compression import CompressedVolume, compressed
from plenopiv.displacement.correlation import Spectra
from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.field import DisplacementField
from plenopiv.displacement.multigrid import multi_grid
from plenopiv.displacement.offset import summed_offset
from plenopiv.displacement.pairs import Progress
from plenopiv.displacement.parts_of_pairs import PartsOfPairs
from plenopiv.displacement.predictor import SplineField
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.solid import Solid
from plenopiv.displacement.uncertainty import (
    OF_MEANS,
    add_left_out,
    around_peaks,
    gain_around,
    jackknife_variance,
    part_left_out,
    variance_of,
)
from plenopiv.displacement.validation import accepted
from plenopiv.displacement.window_pass import PassResult, PassVectors, StepDone, WindowPass
from plenopiv.displacement.windows import WindowGrid
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import Volume, VoxelGrid

PLANES_BYTES = 1 << 30  # of summed correlations held at once; a layer of windows at least


AnyVolume = TypeVar("AnyVolume", bound=Volume, covariant=True)
Given = TypeVar("Given", bound=Volume)


class PairsOfVolumes(Protocol[AnyVolume]):
    """A sequence of pairs of volumes; each may be read anew whenever it is asked for."""

    def __len__(self) -> int:
        """How many."""

    def __getitem__(self, index: int, /) -> tuple[AnyVolume, AnyVolume]:
        """Both volumes of a pair, from 0."""


@dataclass(frozen=True)
class EachVolume(Generic[Given]):
    """``pairs`` whose volumes are changed by ``change`` whenever they are asked for."""

    pairs: PairsOfVolumes[Given]
    change: Callable[[Given], Volume]

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> tuple[Volume, Volume]:
        a, b = self.pairs[index]
        return self.change(a), self.change(b)


def measure_ensemble(
    pairs: PairsOfVolumes[Volume],
    settings: CorrelationSettings,
    progress: Progress | None = None,
    solid: Solid | None = None,
    depth: DepthWeights | None = None,
) -> DisplacementField:
    """The displacement field that all ``pairs`` (first volume, second volume) share, in voxels.

    Passes, windows and settings as for ``measure``; of one pair the result is the same bit for bit. ``pairs[k]`` is
    asked for once in each pass and for each step of the discrete window offset, three times in the last, and as many
    times as often as the windows' correlations take more than ``PLANES_BYTES``; one pair is held at a time. Memory: a
    pair of volumes and what ``measure`` takes for it, and ``PLANES_BYTES`` at most (or one layer of windows, where that
    takes more) for the correlations, 4 bytes for each displacement that is searched of each window; with sub-windows 12
    bytes for each pair and vector. ``progress``, ``solid``, ``depth``: as for ``measure``.

    Raises:
        PlenoPIVError: there is no pair, volumes differ in grid, windows do not fit, or nothing is found.
    """
    if not len(pairs):
        raise PlenoPIVError("ensemble correlation: no pairs were given; give one or more")
    summed = SummedPairs(pairs, settings, depth, solid)
    return multi_grid(summed, summed.grid.shape, settings, progress, solid)


class SummedPairs:
    """The passes' correlations, summed over pairs (``pairs.Pairs``)."""

    def __init__(
        self,
        pairs: PairsOfVolumes[Volume],
        settings: CorrelationSettings,
        depth: DepthWeights | None = None,
        solid: Solid | None = None,
    ) -> None:
        self._depth, self._solid, self._part = depth, solid, part_left_out(settings)
        self._pairs, self._exponent = pairs, settings.intensity_exponent
        self._brightness: list[tuple[float, float]] = []  # of each pair's volumes
        self.grid: VoxelGrid = pairs[0][0].grid

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[tuple[Volume, Volume]]:
        for number in range(len(self)):
            yield self._pair(number)

    def _pair(self, number: int) -> tuple[Volume, Volume]:
        """Both volumes, compressed and scaled to the brightness of the first pair with light."""
        a, b = (compressed(volume, self._exponent) for volume in self._pairs[number])
        for volume, which in ((a, "first"), (b, "second")):
            if volume.grid != self.grid:
                raise PlenoPIVError(
                    f"ensemble correlation: the {which} volume of pair {number + 1} is on another grid than the first "
                    f"pair's: {volume.grid} and {self.grid}; reconstruct all of them on the same one"
                )
        if number == len(self._brightness):
            self._brightness.append((brightness(a), brightness(b)))
        own = self._brightness[number]
        first = next((both for both in self._brightness if min(both) > 0), own)
        return tuple(  # type: ignore[return-value]
            volume if light in (0.0, aim) else CompressedVolume(volume, factor=aim / light)
            for volume, light, aim in zip((a, b), own, first, strict=True)
        )

    def offset(
        self, windows: WindowGrid, first: NDArray[np.float64], progress: Progress | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """See ``summed_offset``; progress counts pairs."""
        if progress is None:
            return summed_offset(self, windows, first, self._depth)
        return summed_offset(_Counted(self, progress), windows, first, self._depth)

    def correlated(
        self,
        windows: WindowGrid,
        predictor: SplineField | None,
        settings: CorrelationSettings,
        search: float,
        step_done: StepDone | None = None,
        scatter: bool = False,
    ) -> PassResult:
        """As ``correlation_pass``; ``step_done`` counts layers of all pairs."""
        batches = WindowPass(windows, predictor, settings, search, self.grid.shape, self._depth)
        vectors = PassVectors(windows, scatter, settings)
        count, total = 0, batches.layers * len(self) * (2 if scatter else 1)

        def layer_done(*_: int) -> None:
            nonlocal count
            count += 1
            if step_done is not None:
                step_done(count, total)

        at_once = max(1, PLANES_BYTES // (4 * batches.count * int(np.prod(batches.plane))))
        parts = [range(n, min(n + at_once, batches.layers)) for n in range(0, batches.layers, at_once)]
        peaks = [self._peaks(batches, layers, vectors, layer_done) for layers in parts]
        if not scatter:
            return vectors.result(predictor)
        means = self._means(vectors, predictor, windows, settings)
        for layers, of_layers in zip(parts, peaks, strict=True):
            self._scatter(batches, layers, of_layers, vectors, means, layer_done)
        found = vectors.result(predictor)
        return found if means is None else replace(found, between_pairs=means.variance())

    def _means(
        self, vectors: PassVectors, predictor: SplineField | None, windows: WindowGrid, settings: CorrelationSettings
    ) -> PartsOfPairs | None:
        """Where pairs' parts in means over sub-windows are summed, those of vectors that count alone; None without."""
        if len(self) == 1 or settings.sub_window is None:
            return None
        found = vectors.result(predictor)
        closed = None if self._solid is None else self._solid.filled(windows, settings.windows[-1])
        known = accepted(found.displacement, found.found, settings, closed) & vectors.scattered[:, None, None]
        return PartsOfPairs(len(self), windows, self.grid.shape, known, settings) if known.any() else None

    def _peaks(self, batches: WindowPass, layers: range, vectors: PassVectors, layer_done: StepDone) -> Peaks:
        """Sum the correlations of some layers of windows and find their peaks."""
        planes = np.zeros((len(layers), batches.count, *batches.plane), np.float32)
        lit = np.zeros((len(layers), batches.count), bool)

        def add(layer: int, part: slice, spectra: Spectra) -> None:
            found = batches.correlator.correlation(spectra)
            found[~spectra.lit] = 0.0  # of uniform windows: rounding
            planes[layer - layers.start, part] += found
            lit[layer - layers.start, part] |= spectra.lit

        for pair in self:
            batches.each_batch(*pair, add, layers, layer_done)
            del pair  # before the next one is loaded
        peaks = Peaks(len(layers), batches.count)

        def find(layer: int, part: slice) -> None:
            here, gain = (layer - layers.start, part), batches.gain(layer, part)
            powers = batches.correlator.powers
            place, untilt, power = vectors.fit(layer, part, planes[here], gain, lit[here], powers)
            peaks.place[here], peaks.untilt[here], peaks.power[here] = place, untilt, power
            peaks.total[here] = around_peaks(planes[here], place) * gain_around(gain, place, power)

        with ThreadPoolExecutor(numba.get_num_threads()) as pool:
            list(pool.map(lambda job: find(*job), [(layer, part) for layer in layers for part in batches.batches]))
        return peaks

    def _scatter(
        self,
        batches: WindowPass,
        layers: range,
        peaks: Peaks,
        vectors: PassVectors,
        means: PartsOfPairs | None,
        layer_done: StepDone,
    ) -> None:
        """The variance of the peaks of some layers of windows; each pair's part in them goes to the ``means``."""
        shape, correlator = (len(layers), batches.count), batches.correlator
        blocks = int(correlator.blocks.prod())
        sums, of_pairs, of_cells, of_pair = (np.zeros((*shape, *rest)) for rest in ((blocks, 7), *[(2, 3)] * 3))

        def add(layer: int, part: slice, spectra: Spectra) -> None:
            if not vectors.scattered[layer]:
                return
            here = layer - layers.start, part
            own = correlator.contributions(spectra, peaks.place[here], peaks.power[here])
            own[~spectra.lit] = 0.0
            sums[here] += own
            about = peaks.total[here], peaks.untilt[here], OF_MEANS
            if means is None:
                add_left_out(own, *about, of_cells[here])
            of_pair[here] = 0.0
            add_left_out(own.sum(1, keepdims=True), *about, of_pair[here])

        for number in range(len(self)):
            batches.each_batch(*self._pair(number), add, layers, layer_done)
            of_pairs += of_pair
            if means is not None:
                means.add(number, layers, of_pair[:, :, 0])
        for layer in range(len(layers)):
            variance = jackknife_variance(sums[layer], peaks.untilt[layer], self._part)
            if len(self) > 1 and means is None:
                more = variance_of(of_pairs[layer], len(self), OF_MEANS)  # a whole pair may be all that a window has
                more -= variance_of(of_cells[layer], len(self) * blocks, OF_MEANS)
                variance += np.maximum(more, 0.0)
            vectors.variance[layers.start + layer] = variance


class Peaks:
    """Where the peaks of ``layers`` of ``count`` windows are: ``place``, ``untilt`` and ``power`` as of
    ``find_peaks``, ``total`` the normalised correlation ``around_peaks``."""

    def __init__(self, layers: int, count: int) -> None:
        self.place = np.zeros((layers, count, 3), np.int64)
        self.untilt = np.zeros((layers, count, 3, 3))
        self.power = np.ones((layers, count, 3))
        self.total = np.zeros((layers, count, 7))


class _Counted:
    """Pairs, with a word to ``progress`` after each."""

    def __init__(self, pairs: SummedPairs, progress: Progress) -> None:
        self._pairs, self._report, self._sweeps = pairs, progress, 0

    def __iter__(self) -> Iterator[tuple[Volume, Volume]]:
        self._sweeps += 1
        report = partial(self._report, f"discrete window offset, step {self._sweeps}")
        for done, number in enumerate(range(len(self._pairs)), 1):
            yield self._pairs._pair(number)
            report(done, len(self._pairs))


def brightness(volume: Volume) -> float:
    """Sum of v^2 over sum of |v|: the brightness of a typical voxel of a particle, however many particles there are; 0
    without light."""
    values = volume.values.ravel()
    total = float(np.abs(values).sum(dtype=np.float64))
    return float(np.square(values).sum(dtype=np.float64)) / total if total > 0 else 0.0
