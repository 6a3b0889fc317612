"""Where two velocity fields both have vectors, and the second read at the first's: linear interpolation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.velocity import replaced

if TYPE_CHECKING:
    import xarray

AXES = ("z", "y", "x")
NEAR = 1e-6  # of the distance between vectors: places nearer than this are the same


@dataclass(frozen=True)
class Field:
    """One time of a velocity field: ``velocity`` and ``std`` (3, nz, ny, nx) in m/s, components u, v, w, ``std`` NaN
    where none is stated; which vectors were ``measured`` and which ``replaced`` (nz, ny, nx)."""

    velocity: NDArray[np.float64]
    std: NDArray[np.float64]
    measured: NDArray[np.bool_]
    replaced: NDArray[np.bool_]

    @classmethod
    def of(cls, field: xarray.Dataset) -> Field:
        """Of a dataset of one time, in memory, dims (z, y, x)."""
        ordered = field.transpose(*AXES)
        velocity = np.stack([ordered[name].values.astype(float) for name in "uvw"])
        names = [f"{name}_std" for name in "uvw"]
        stated = all(name in ordered and ordered[name].dims == AXES for name in names)
        std = np.stack([ordered[n].values.astype(float) for n in names]) if stated else np.full(velocity.shape, np.nan)
        finite = np.isfinite(velocity).all(0)  # not where nothing was measured: in a body, or at a time set aside
        return cls(velocity, std, (ordered["valid"].values == 1) & finite, replaced(ordered).values & finite)


@dataclass(frozen=True)
class _Along:
    """Along one axis: which of A's vectors lie within B's, and between which of B's (``low`` and the next one), at
    which ``share`` of the way."""

    inside: NDArray[np.intp]
    low: NDArray[np.intp]
    share: NDArray[np.float64]

    @classmethod
    def of(cls, a_mm: NDArray[np.float64], b_mm: NDArray[np.float64]) -> _Along:
        """Between rising coordinates."""
        near = NEAR * min((float(np.diff(c).min()) for c in (a_mm, b_mm) if c.size > 1), default=1.0)
        inside = np.flatnonzero((a_mm >= b_mm[0] - near) & (a_mm <= b_mm[-1] + near))
        place = a_mm[inside]
        low = np.clip(np.searchsorted(b_mm, place + near, side="right") - 1, 0, b_mm.size - 1)
        step = np.diff(b_mm, append=b_mm[-1] + 1.0)
        share = (place - b_mm[low]) / step[low]
        return cls(inside, low, np.where(np.abs(place - b_mm[low]) <= near, 0.0, share))

    def read(self, values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        """Values of B between its vectors; what stands at a vector that counts nothing makes no difference."""
        left = np.take(values, self.low, axis)
        if not self.share.any():
            return left
        right = np.take(values, np.minimum(self.low + 1, values.shape[axis] - 1), axis)
        share = self.share.reshape([-1 if k == axis % values.ndim else 1 for k in range(values.ndim)])
        with np.errstate(invalid="ignore"):  # infinities
            return np.where(share == 0, left, left + share * (right - left))


@dataclass(frozen=True)
class Overlap:
    """The vectors of a field A that lie within those of a field B, and how B is read there."""

    z: _Along
    y: _Along
    x: _Along

    @classmethod
    def of(cls, a_mm: Mapping[str, NDArray[np.float64]], b_mm: Mapping[str, NDArray[np.float64]]) -> Overlap:
        """Of the fields' coordinates in mm, rising, by axis."""
        return cls(*(_Along.of(np.asarray(a_mm[axis], float), np.asarray(b_mm[axis], float)) for axis in AXES))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Vectors of A within B along z, y, x."""
        return self.z.inside.size, self.y.inside.size, self.x.inside.size

    @property
    def interpolates(self) -> bool:
        """Whether B's vectors lie elsewhere than A's."""
        return any(along.share.any() for along in (self.z, self.y, self.x))

    def of_a(self, a: Field) -> Field:
        """A's own vectors in the overlap."""

        def cut(values: NDArray) -> NDArray:
            return values[..., self.z.inside, :, :][..., self.y.inside, :][..., self.x.inside]

        return Field(cut(a.velocity), cut(a.std), cut(a.measured), cut(a.replaced))

    def of_b(self, b: Field) -> Field:
        """B at A's vectors: measured where all the vectors that it lies between were, replaced where one of them was.

        Standard deviations are read linearly too: the errors of neighbouring vectors, whose windows overlap, are alike.
        """
        velocity, std = self._read(b.velocity), self._read(b.std)
        measured = self._read((~b.measured).astype(float)) == 0
        return Field(velocity, std, measured, self._read(b.replaced.astype(float)) > 0)

    def _read(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        for axis, along in zip((-3, -2, -1), (self.z, self.y, self.x), strict=True):
            values = along.read(values, values.ndim + axis)
        return values
