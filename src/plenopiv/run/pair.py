"""One frame reconstructed, and a pair of them correlated: what a series repeats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from plenopiv.chain import Chain
from plenopiv.checks.explained import unexplained_share
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.reconstruct import Reconstruction
from plenopiv.recording import ImageSource, Recording

if TYPE_CHECKING:
    import xarray

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Frame:
    """A frame of a recording, reconstructed: its number from 0, where it came from, its upright image in counts
    without static light, and the share of its light that the volume does not explain (``unexplained_share``)."""

    number: int
    source: ImageSource
    image: NDArray
    found: Reconstruction
    unexplained: float | None

    @property
    def name(self) -> str:
        """As messages and ``summary.json`` have it."""
        return self.source.name

    def summary(self) -> dict[str, Any]:
        """Its entry in ``summary.json``."""
        return {
            "dark_noise_counts": self.found.noise.dark,
            "counts_per_electron": self.found.noise.counts_per_electron,
            "typical_particle_counts": self.found.particle,
            "threshold_counts": self.found.threshold,
            "candidate_share": self.found.candidates,
            "residual_counts_by_round": list(self.found.residuals),
            "voxels_kept": int(self.found.volume.column.size),
            "unexplained_share": self.unexplained,
        }


def reconstructed(chain: Chain, recording: Recording, number: int, progress: Progress) -> Frame:
    """Frame ``number`` (from 0) of a recording.

    Raises:
        PlenoPIVError: its image cannot be used, or shows no particles.
    """
    source, (light, static) = recording.frames[number], recording.light(number)
    behind = None if static is None else [static]
    found = chain.reconstruct([light], source.name, partial(progress, f"reconstruction of {source.name}"), behind)
    left = None
    if isinstance(chain.projection, PlenopticProjector):
        left = unexplained_share(chain.projection, found.volume, light, found.noise)
    return Frame(number, source, light, found, left)


def velocity_between(
    chain: Chain, before: Frame, after: Frame, dt_s: float, time_s: float, progress: Progress
) -> xarray.Dataset:
    """The velocity field from one frame to another, ``dt_s`` later, at mid-time ``time_s``.

    Raises:
        PlenoPIVError: nothing is found.
    """
    return chain.velocity(before.found.volume, after.found.volume, dt_s, time_s, progress)
