"""What each of many pairs, whose correlations are summed, does to the means over sub-windows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.displacement.resolution import averaged_share
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.sub_windows import mean_over, mean_weights
from plenopiv.displacement.uncertainty import OF_MEANS, variance_of
from plenopiv.displacement.windows import WindowGrid, window_grid


class PartsOfPairs:
    """How far the means over sub-windows move where a part of one of ``count`` pairs is left out, summed layer by layer
    as the vectors are.

    ``windows``: the sub-windows of volumes of ``shape``; ``known`` (nz, ny, nx): which of them have a vector of their
    own, whose scatter is known. Others, whose vectors come from their neighbours, take the part of the nearest of their
    layer; layers without any take the mean of the next ones that have some. Memory: 12 bytes for each pair and vector.
    """

    def __init__(
        self,
        count: int,
        windows: WindowGrid,
        shape: tuple[int, int, int],
        known: NDArray[np.bool_],
        settings: CorrelationSettings,
    ) -> None:
        whole = window_grid(shape, settings.windows[-1], settings.overlap)
        weights, *self._across = mean_weights(whole, windows, True, averaged_share(settings))
        self._nearest = [_nearest(layer) for layer in known]
        some = np.flatnonzero(known.any((1, 2)))
        self._of_layers = np.zeros_like(weights)
        for layer in range(len(known)):
            after = np.searchsorted(some, layer)
            beside = some[after : after + 1] if layer in some else some[max(after - 1, 0) : after + 1]
            for other in beside:
                self._of_layers[:, other] += weights[:, layer] / len(beside)
        self._rows, self._moved = windows.shape[1:], np.zeros((count, 3, *whole.shape), np.float32)

    def add(self, number: int, layers: range, moved: NDArray[np.float64]) -> None:
        """The part of pair ``number`` in some layers of sub-windows: ``moved`` (layers, windows of a layer, 3)."""
        filled = np.stack([own[self._nearest[layer]] for layer, own in zip(layers, moved, strict=True)])
        of_axes = np.moveaxis(filled.reshape(len(layers), *self._rows, 3), -1, 0)
        weights = self._of_layers[:, layers.start : layers.stop], *self._across
        self._moved[number] += mean_over(of_axes, weights)  # type: ignore[arg-type]

    def variance(self) -> NDArray[np.float64]:
        """Of the means (3, nz, ny, nx), as the pairs tell it."""
        moments = np.zeros((2, *self._moved.shape[1:]))
        for moved in self._moved:
            moments += moved, np.square(moved, dtype=np.float64)
        of_axes = np.moveaxis(moments, (0, 1), (-2, -1))
        return np.moveaxis(variance_of(of_axes, len(self._moved), OF_MEANS), -1, 0)


def _nearest(known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """For each window of a layer (ny, nx) the number of the nearest that is known, or its own where none is."""
    numbers = np.arange(known.size)
    if known.any():
        of_known = np.flatnonzero(known)
        numbers = of_known[cKDTree(np.argwhere(known)).query(np.argwhere(np.ones_like(known)))[1]]
    return numbers
