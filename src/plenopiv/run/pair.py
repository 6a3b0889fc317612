"""One frame reconstructed, and a pair of them correlated: what a series repeats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.chain import Chain
from plenopiv.reconstruction.reconstruct import Reconstruction
from plenopiv.recording import Recording

if TYPE_CHECKING:
    import xarray

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Frame:
    """A frame of a recording, reconstructed: its number from 0, its file's name and its upright image in counts."""

    number: int
    name: str
    image: NDArray[np.uint16]
    found: Reconstruction

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
        }


def reconstructed(chain: Chain, recording: Recording, number: int, progress: Progress) -> Frame:
    """Frame ``number`` (from 0) of a recording.

    Raises:
        PlenoPIVError: its image cannot be used, or shows no particles.
    """
    name = recording.names[number]
    image = recording.frame(number)
    found = chain.reconstruct([image], name, partial(progress, f"reconstruction of {name}"))
    return Frame(number, name, image, found)


def velocity_between(chain: Chain, before: Frame, after: Frame, dt_s: float, progress: Progress) -> xarray.Dataset:
    """The velocity field from one frame to the next, ``dt_s`` later; time counts from the recording's first frame.

    Raises:
        PlenoPIVError: nothing is found.
    """
    mid_time_s = (before.number + 0.5) * dt_s
    return chain.velocity(before.found.volume, after.found.volume, dt_s, mid_time_s, progress)
