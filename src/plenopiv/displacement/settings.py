"""What the user may choose about the correlation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Real
from typing import Any, NamedTuple

from plenopiv.errors import PlenoPIVError

Size = tuple[int, int, int]
Sides = tuple[float, float, float]


SMALLEST = 8  # voxels of a window along an axis
SUB_WINDOW = 0.75, 0.75, 0.8125  # default sides of a sub-window, as fractions of the last window's along x, y, z
HALF = 0.5  # overlap at which the filter between passes stops waves of one window


def _size(value: Any) -> Size | None:
    """Sides x, y, z of a window from any three whole numbers, as of a list; None from anything else."""
    try:
        x, y, z = (int(side) for side in value)
        whole = (x, y, z) == tuple(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return (x, y, z) if whole and min(x, y, z) >= SMALLEST else None


def _shown(value: Any) -> str:
    """A value as the experiment file has it."""
    return f"[{', '.join(map(_shown, value))}]" if isinstance(value, list | tuple) else str(value)


class Pass(NamedTuple):
    """One correlation pass: sides of its windows along x, y, z in voxels, and their overlap."""

    window: Size
    overlap: float


@dataclass(frozen=True)
class CorrelationSettings:
    """Multi-grid cross-correlation with window deformation; lengths in voxels, sizes along x, y, z.

    ``windows``: interrogation windows, coarse to fine. ``overlap``: of neighbouring windows, as a fraction of a window.
    ``inner_window``: sub-windows, smaller than the last of ``windows``; a vector of that window is the mean of the
    sub-windows' vectors over most of it (``displacement.resolution``). None: 0.75 of the last of ``windows`` along x
    and y, 0.8125 along z, where particles are long; 8 voxels at least. As large as the last of ``windows``: no
    sub-windows.
    ``inner_overlap``: of sub-windows in the last pass; in those before it half at most, since the filter between passes
    lets waves of a window's length through where vectors stand closer.
    ``coarse_passes``, ``fine_passes``: passes with each coarse window size and with the finest one. All but the very
    first pass deform the volumes by the displacement known so far.
    ``smoothing_voxels``: sigma of the Gaussian that both volumes see before correlation, one number or along x, y, z;
    blobs of one or two voxels lock peaks to whole voxels without it. In deformed volumes it is at least 0.58, the sigma
    of the spline.
    ``taper_voxels``: width of the windows' taper; particles cut by the border bias the peak toward zero.
    ``intensity_exponent``: intensities are raised to this power first. Correlation weighs a particle by the square of
    its brightness; with 0.5 many moderate particles count instead of a few bright ones.
    ``whitening``: exponent of symmetric phase-only filtering (Wernet 2005): 0 = plain correlation, 1 = phases alone.
    ``agreement``: exponent of the weight that each place of the deformed volumes has by how far both show the same
    particles there, so that ghosts and lost particles count less (``displacement.agreement``). 0: all weights are one.
    Above 0 it favours the displacement of the pass before, so it suits flows that change little across a window.
    ``search``: largest displacement that a pass can find, as a fraction of the window along each axis;
    ``residual_search``: the same for the passes with the finest windows.
    ``outlier_threshold``, ``outlier_floor_voxels``: normalised median test, Westerweel & Scarano (2005): a vector is
    an outlier when it differs from the median of its neighbours by more than threshold x (median residual + floor).
    ``filter_predictor``: whether the displacement that deforms the volumes is low-pass filtered first
    (``predictor.smooth_predictor``). The result of the last pass is never filtered.

    Sizes may be lists, and are kept as tuples of int. Raises ``PlenoPIVError`` for values out of range.
    """

    windows: tuple[Size, ...] = ((128, 128, 32), (64, 64, 16))
    overlap: float = 0.5
    inner_window: Size | None = None
    inner_overlap: float = 0.6
    coarse_passes: int = 1
    fine_passes: int = 2
    smoothing_voxels: float | Sides = (1.0, 1.0, 0.8)
    taper_voxels: float = 2.0
    intensity_exponent: float = 0.5
    whitening: float = 0.5
    agreement: float = 0.0
    search: float = 0.375
    residual_search: float = 0.25
    outlier_threshold: float = 3.0
    outlier_floor_voxels: float = 0.1
    filter_predictor: bool = True

    @property
    def sub_window(self) -> Size | None:
        """Sides of the sub-windows along x, y, z in voxels; None without sub-window averaging."""
        last = self.windows[-1]
        size = self.inner_window or tuple(
            max(SMALLEST, round(share * n)) for share, n in zip(SUB_WINDOW, last, strict=True)
        )
        return None if size == last else size  # type: ignore[return-value]

    @property
    def smoothing(self) -> Sides:
        """Sigma of the Gaussian along x, y, z, voxels."""
        sigma = self.smoothing_voxels
        return sigma if isinstance(sigma, tuple) else (sigma, sigma, sigma)

    @property
    def passes(self) -> list[Pass]:
        """All passes in turn."""
        sizes = [Pass(window, self.overlap) for window in self.windows]
        last = sizes[-1]
        if self.sub_window is not None:
            last = Pass(self.sub_window, self.inner_overlap)
            sizes.append(Pass(self.sub_window, min(self.inner_overlap, HALF)))
        coarse = [size for size in sizes[:-1] for _ in range(self.coarse_passes)]
        return [*coarse, *[sizes[-1]] * (self.fine_passes - 1), last]

    def __post_init__(self) -> None:
        self._keep_tuples()
        for coarse, fine in zip(self.windows, self.windows[1:], strict=False):
            if any(f > c for c, f in zip(coarse, fine, strict=True)):
                raise PlenoPIVError(
                    f"correlation.windows: {list(fine)} follows {list(coarse)}; sort them coarse to fine"
                )
        if self.inner_window is not None and any(
            n > c for n, c in zip(self.inner_window, self.windows[-1], strict=True)
        ):
            raise PlenoPIVError(
                f"correlation.inner_window: {list(self.inner_window)} is larger than the last of "
                f"correlation.windows, {list(self.windows[-1])}; sub-windows lie within that"
            )
        ranges = {
            "overlap": (0.0, 0.9),
            "inner_overlap": (0.0, 0.9),
            "coarse_passes": (1, 20),
            "fine_passes": (1, 20),
            "taper_voxels": (0.0, 4.0),
            "intensity_exponent": (0.1, 2.0),
            "whitening": (0.0, 1.0),
            "agreement": (0.0, 10.0),
            "search": (0.05, 0.45),
            "residual_search": (0.05, 0.45),
            "outlier_threshold": (0.5, 100.0),
            "outlier_floor_voxels": (1e-3, 10.0),
        }
        values = [(name, getattr(self, name), *limits) for name, limits in ranges.items()]
        values += [("smoothing_voxels", sigma, 0.0, 4.0) for sigma in self.smoothing]
        for name, value, lo, hi in values:
            number = isinstance(value, Real)
            if not (number and lo <= value <= hi):
                raise PlenoPIVError(f"correlation.{name}: {value} is out of range; use {lo} to {hi}")
            if name.endswith("_passes"):
                if value != int(value):
                    raise PlenoPIVError(f"correlation.{name}: {value} is no whole number; use {lo} to {hi}")
                object.__setattr__(self, name, int(value))

    def _keep_tuples(self) -> None:
        """Sizes and sigmas as tuples, of lists as well: settings are hashed once all passes are made."""
        sizes = [_size(window) for window in self.windows] if isinstance(self.windows, Iterable) else []
        if not sizes or None in sizes:
            raise PlenoPIVError(
                f"correlation.windows: {_shown(self.windows)}: give sizes [x, y, z] of 8 voxels or more, coarse to fine"
            )
        object.__setattr__(self, "windows", tuple(sizes))
        if self.inner_window is not None:
            if (inner := _size(self.inner_window)) is None:
                raise PlenoPIVError(
                    f"correlation.inner_window: {_shown(self.inner_window)}: give a size [x, y, z] of 8 voxels or more"
                )
            object.__setattr__(self, "inner_window", inner)
        if isinstance(sigmas := self.smoothing_voxels, Iterable):
            object.__setattr__(self, "smoothing_voxels", tuple(sigmas))
            if len(self.smoothing) != 3:
                raise PlenoPIVError(
                    f"correlation.smoothing_voxels: {_shown(sigmas)}: give one number, or three along x, y, z"
                )
