"""One frame of a recording, reconstructed; or why it was lost."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Protocol, TypeVar

from numpy.typing import NDArray

from plenopiv.chain import Chain
from plenopiv.checks.explained import unexplained_share
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.reconstruct import Reconstruction
from plenopiv.recording import ImageSource, Recording
from plenopiv.run.inputs import frame_entry, read_entry

Progress = Callable[[str, int, int], None]


class OfAFrame(Protocol):
    """A dataclass of a frame, with the field ``warned``: what was warned of while it was made."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


Taken = TypeVar("Taken", bound=OfAFrame)


@dataclass(frozen=True)
class Frame:
    """A frame of a recording, reconstructed: its number from 0, where it came from, its upright image in counts
    without static light, the share of its light that the volume does not explain (``unexplained_share``), its entry in
    the manifest, what was warned of, and the static light where it is asked for."""

    number: int
    source: ImageSource
    image: NDArray
    found: Reconstruction
    unexplained: float | None
    entry: dict[str, Any]
    warned: tuple[str, ...] = ()
    static: NDArray | None = None

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
            "residual_counts_by_iteration": list(self.found.residuals),
            "voxels_kept": int(self.found.volume.column.size),
            "unexplained_share": self.unexplained,
        }


@dataclass(frozen=True)
class LostFrame:
    """A frame that cannot be read, or shows no particles; ``entry``: in the manifest."""

    number: int
    source: ImageSource
    reason: str
    entry: dict[str, Any]
    warned: tuple[str, ...] = ()


def reconstructed(
    chain: Chain, recording: Recording, number: int, progress: Progress, with_static: bool = False
) -> Frame:
    """Frame ``number`` (from 0) of a recording. ``with_static``: its static light is kept, as where it will be
    reconstructed again.

    Raises:
        PlenoPIVError: its image cannot be used, or shows no particles.
    """
    source = recording.frames[number]
    entry = frame_entry(source)  # before it is read: a file that is replaced later is then another one
    light, static = recording.light(number)
    behind = None if static is None else [static]
    found = chain.reconstruct([light], source.name, partial(progress, f"reconstruction of {source.name}"), behind)
    left = None
    if isinstance(chain.projection, PlenopticProjector):
        left = unexplained_share(chain.projection, found.volume, light, found.noise)
    kept = static if with_static or chain.reconstruction.motion_tracking else None
    return Frame(number, source, light, found, left, read_entry(entry, light), static=kept)


def taken_or_lost(recording: Recording, number: int, take: Callable[[], Taken]) -> Taken | LostFrame:
    """What ``take`` makes of frame ``number`` (from 0), with what was warned of meanwhile; or why the frame is lost.

    Raises:
        PlenoPIVError: its file is gone since the run began: others will be too, and the cause can be removed.
    """
    source = recording.frames[number]
    entry = frame_entry(source)
    found: Taken | LostFrame
    with caught_warnings() as said:
        try:
            found = take()
        except PlenoPIVError as error:
            if number not in recording.damaged and not os.path.exists(source.path):
                raise PlenoPIVError(f"{source.path}: is gone since the run began") from None
            found = LostFrame(number, source, str(error), entry)
    return replace(found, warned=tuple(said))


@contextmanager
def caught_warnings() -> Iterator[list[str]]:
    """Collect PlenoPIV's warnings instead of showing them, each once. The list is empty until the block has ended."""
    said: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            yield said
        finally:
            texts = [str(one.message) for one in caught if issubclass(one.category, PlenoPIVWarning)]
            said += dict.fromkeys(texts)
    for one in caught:
        if not issubclass(one.category, PlenoPIVWarning):
            warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
