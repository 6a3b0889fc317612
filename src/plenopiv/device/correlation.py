"""Displacement fields on the device: the passes of ``displacement.multigrid`` with windows correlated by JAX.

Volumes are dense on the device, as a whole or a few planes at a time. A pass deforms them layer by layer of windows and
correlates a layer batch by batch; a window's peak and its neighbours come back, which the host fits in double
precision. Validation, replacement, splines and error bars are the host's own.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from plenopiv.device.correlation_deformation import Deformed, Planes
from plenopiv.device.correlation_memory import Room, room
from plenopiv.device.correlation_offset import discrete_offset
from plenopiv.device.correlation_windows import Found, How, correlated
from plenopiv.displacement import multigrid
from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.field import DisplacementField
from plenopiv.displacement.overlap import PLAIN
from plenopiv.displacement.pairs import Progress
from plenopiv.displacement.peaks import find_peaks
from plenopiv.displacement.predictor import SplineField
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.solid import Solid
from plenopiv.displacement.uncertainty import jackknife_variance, part_left_out
from plenopiv.displacement.window_pass import PassResult, PassVectors, StepDone, WindowPass
from plenopiv.displacement.windows import WindowGrid
from plenopiv.volume import Volume

# gain of a peak's neighbourhood, which is corrected already, and its power
_ALONE, _AS_IT_IS = (np.ones((1, 3), np.float32),) * 3, np.ones((3, PLAIN + 2))


def measure(
    a: Volume,
    b: Volume,
    settings: CorrelationSettings,
    progress: Progress | None = None,
    solid: Solid | None = None,
    memory: float | None = None,
    depth: DepthWeights | None = None,
) -> DisplacementField:
    """``multigrid.measure`` on the device. ``memory``: bytes of it that may be taken; None for what volumes as a whole
    and large batches take.

    Raises:
        PlenoPIVError: as there; the memory does not suffice for the planes of one layer of windows.
    """
    plan = room(a.grid.shape, settings, memory)
    return multigrid.measure(a, b, settings, progress, solid, partial(DevicePair, plan=plan), depth)


class DevicePair:
    """Two volumes on the device, ``both`` as ``Planes``, and what their light counts by its depth
    (``pairs.Pairs``)."""

    def __init__(self, a: Volume, b: Volume, depth: DepthWeights | None, plan: Room) -> None:
        self._shape, self._depth, self._plan = a.grid.shape, depth, plan
        self.both = Planes(a, plan.resident), Planes(b, plan.resident)

    def offset(
        self, windows: WindowGrid, first: NDArray[np.float64], progress: Progress | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """See ``offset.discrete_offset``."""
        _, rows, columns = windows.shape
        batch = self._plan.batch(windows.size, rows * columns)
        return discrete_offset(*self.both, windows, first, batch, self._depth)

    def correlated(
        self,
        windows: WindowGrid,
        predictor: SplineField | None,
        settings: CorrelationSettings,
        search: float,
        step_done: StepDone | None = None,
        scatter: bool = False,
    ) -> PassResult:
        """See ``multigrid.correlation_pass``."""
        batches = WindowPass(windows, predictor, settings, search, self._shape, self._depth)
        vectors = PassVectors(windows, scatter, settings)
        depth, step = windows.size[0], windows.step[0]
        a, b = (
            Deformed(planes, predictor, share, depth, step)
            for planes, share in zip(self.both, (-0.5, 0.5), strict=True)
        )
        correlator = batches.correlator
        filters = tuple(jnp.asarray(each) for each in correlator.filters)
        powers = jnp.asarray(correlator.powers, jnp.float32)
        take = partial(_take, vectors=vectors, part=part_left_out(settings))
        waiting = dict[int, list[Found]]()
        for layer, start in enumerate(windows.starts[0].tolist()):
            planes = a.layer(start), b.layer(start)
            how = How.of(batches, bool(vectors.scattered[layer]))
            waiting[layer] = self.layer(batches, layer, planes, filters, powers, how)
            if layer:  # while the device computes this layer
                take(waiting.pop(layer - 1), layer - 1)
                if step_done is not None:
                    step_done(layer, batches.layers)
        take(waiting.pop(batches.layers - 1), batches.layers - 1)
        if step_done is not None:
            step_done(batches.layers, batches.layers)
        return vectors.result(predictor)

    def layer(
        self,
        batches: WindowPass,
        layer: int,
        planes: tuple[jax.Array, jax.Array],
        filters: tuple[jax.Array, ...],
        powers: jax.Array,
        how: How,
    ) -> list[Found]:
        """The windows of a layer, cut out of its ``planes`` of both volumes."""
        batch = self._plan.batch(how.around, batches.count)
        parts = _parts(batches.count, batch)
        return [correlated(*planes, *_of_batch(batches, layer, part, batch), filters, powers, how) for part in parts]


def _parts(count: int, batch: int) -> Iterator[NDArray[np.int64]]:
    """The windows of a layer, ``batch`` at a time; the last batch is filled up with the last window."""
    for lo in range(0, count, batch):
        yield np.minimum(np.arange(lo, lo + batch), count - 1)


def _of_batch(batches: WindowPass, layer: int, part: NDArray[np.int64], batch: int) -> tuple[jax.Array, ...]:
    """Corners, cuts and weights by depth of a batch of windows."""
    cuts = np.zeros((batch, 3, 2), np.float32) if batches.cuts is None else batches.cuts[layer, part]
    depth = batches.depth_weights(layer, part)
    if depth is None:
        depth = np.ones((batch, batches.windows.size[0]), np.float32)
    return jnp.asarray(batches.corners[part], jnp.int32), jnp.asarray(cuts, jnp.float32), jnp.asarray(depth)


def _take(found: list[Found], layer: int, vectors: PassVectors, part: float) -> None:
    """Fit the peaks of a layer of windows, and their variance where blocks were summed (``jackknife_variance``)."""
    count = vectors.found.shape[1]
    whole: dict[str, Any] = {}
    for name in Found._fields:
        parts = [getattr(each, name) for each in found]
        whole[name] = None if parts[0] is None else np.concatenate([np.asarray(each) for each in parts])[:count]
    moved, ratio, fitted = np.zeros((count, 3)), np.zeros(count, np.float32), np.zeros(count, bool)
    place, untilt, power = np.zeros((count, 3), np.int64), np.zeros((count, 3, 3)), np.ones((count, 3))
    find_peaks(whole["near"], _ALONE, moved, ratio, fitted, place, untilt, _AS_IT_IS, power)  # of one voxel: the middle
    vectors.found[layer], vectors.ratio[layer] = whole["found"], whole["ratio"]
    vectors.moved[layer] = np.where(whole["lit"][:, None], moved + whole["place"], 0.0)
    if whole["sums"] is not None:
        vectors.variance[layer] = jackknife_variance(whole["sums"].astype(np.float64), untilt, part)
