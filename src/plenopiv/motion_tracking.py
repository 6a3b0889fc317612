"""Both frames of a pair reconstructed together: motion-tracking enhancement (Novara, Batenburg & Scarano 2010, Meas.
Sci. Technol. 21 035401).

Ghosts of the two frames lie elsewhere, particles lie where the flow takes them. So each frame is reconstructed again
from a first guess that both share: the mean of its own volume and of the other's, displaced to it by the velocity field
that was measured between them. What only one of them has is half as bright in it. It helps where images overlap; where
ghosts move as particles do, as in fluid at rest, it tells them apart no better than before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from plenopiv.chain import Chain
from plenopiv.displacement.deformation import DeformedPlanes
from plenopiv.displacement.field import DisplacementField
from plenopiv.displacement.pairs import Progress
from plenopiv.displacement.predictor import SplineField, fit_spline
from plenopiv.volume import SparseVolume

FAINTEST = 0.1  # of the guess's mean, added to every candidate: MART multiplies, and what is 0 stays so
VOXELS_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class SharedGuess:
    """The light that a frame's candidates begin with: ``own`` volume of the frame, and planes of the other frame's,
    ``moved`` to it."""

    own: SparseVolume
    moved: DeformedPlanes

    def __call__(self, volume: SparseVolume) -> NDArray[np.float32]:
        """Of the listed voxels of ``volume``, on the same grid or on some rows of it; of any total."""
        nz, ny, nx = volume.grid.shape
        whole = self.own.grid
        first = round((volume.grid.first_mm[1] - whole.first_mm[1]) / whole.voxel_mm[1])
        planes = max(1, VOXELS_AT_ONCE // (whole.shape[1] * nx))
        out = np.empty(volume.values.size, np.float32)
        for lo in range(0, nz, planes):
            hi = min(lo + planes, nz)
            light = self.own.slab(lo, hi)[:, first : first + ny] + self.moved.slab(lo, hi)[:, first : first + ny]
            start = volume.row_start[lo * ny : hi * ny + 1]
            row = np.repeat(np.arange((hi - lo) * ny), np.diff(start))
            out[start[0] : start[-1]] = light.reshape(-1, nx)[row, volume.column[start[0] : start[-1]]]
        out += np.float32(FAINTEST) * out.mean(dtype=np.float64).astype(np.float32)
        return out


def displacement_of_frame(chain: Chain, field: DisplacementField, sign: int) -> SplineField:
    """Where the voxels of ``chain.lens_grid`` of the first frame (``sign`` 1) are in the second, or the other way round
    (-1), less where they are, in voxels; ``field`` is that at mid-time, on ``chain.grid``."""
    laboratory, lens, space = chain.grid, chain.lens_grid, chain.space
    centres = field.z, field.y, field.x
    if space is not None:
        spans = (np.linspace(0, n - 1, max(len(c), 2)) for n, c in zip(lens.shape, centres, strict=True))
        z, y, x = spans
        centres = z, y, x
    at = np.stack(np.meshgrid(*centres, indexing="ij")[::-1], -1)
    place = lens.first_mm + at * lens.voxel_mm
    seen = place if space is None else space.to_laboratory(place)
    index = (seen - laboratory.first_mm) / laboratory.voxel_mm
    moved = sign * _at(field, index + sign * 0.5 * _at(field, index))
    end = seen + moved * laboratory.voxel_mm
    displaced = ((end if space is None else space.to_lens(end)) - place) / lens.voxel_mm
    return fit_spline(np.moveaxis(displaced, -1, 0), centres, lens.shape)


def reconstruct_together(
    chain: Chain,
    images: Sequence[NDArray],
    volumes: Sequence[SparseVolume],
    names: Sequence[str] = ("first frame", "second frame"),
    static: Sequence[NDArray | None] = (None, None),
    progress: Progress | None = None,
) -> tuple[SparseVolume, SparseVolume]:
    """The volumes of both frames of a pair, reconstructed ``chain.reconstruction.motion_tracking`` times more from what
    they share. ``images``: upright, in counts, of one camera; ``volumes``: reconstructed from each alone; ``names``,
    ``static``: of each, as for ``Chain.reconstruct``.

    Raises:
        PlenoPIVError: as ``Chain.displacement`` and ``Chain.reconstruct``.
    """
    first, second = volumes
    for _ in range(chain.reconstruction.motion_tracking):
        field = chain.displacement(first, second, progress)
        again = []
        for k, (own, other, sign) in enumerate(((first, second, 1), (second, first, -1))):
            guess = SharedGuess(own, DeformedPlanes(other, displacement_of_frame(chain, field, sign), 1.0))
            light = static[k]
            behind = None if light is None else [light]
            report = None if progress is None else partial(progress, f"{names[k]} again, with both frames")
            again.append(chain.reconstruct([images[k]], names[k], report, behind, guess).volume)
        first, second = again
    return first, second


def _at(field: DisplacementField, index: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement (..., 3) x, y, z at voxels ``index`` (..., 3) x, y, z, between vectors linear, beyond them as at the
    nearest; none in a body."""
    nodes = []
    for axis, centres in enumerate((field.z, field.y, field.x)):
        step = centres[1] - centres[0] if len(centres) > 1 else 1.0
        nodes.append((index[..., 2 - axis] - centres[0]) / step)
    each = (map_coordinates(np.nan_to_num(d), nodes, order=1, mode="nearest") for d in field.displacement)
    return np.stack(list(each), -1)
