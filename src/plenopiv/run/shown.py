"""What the report shows of the first frame that was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from plenopiv.chain import Chain
from plenopiv.lightfield import decode
from plenopiv.recording import Recording
from plenopiv.report import light_field_stacks, projections, raw_crops, volume_stack
from plenopiv.run.frame import Frame, LostFrame, Progress, reconstructed
from plenopiv.run.log import Clock
from plenopiv.volume import SparseVolume


@dataclass(frozen=True)
class FirstFrame:
    """Crops of a frame's image, projections of its volume, and stacks of both."""

    crops: Any
    views: Any
    stacks: Any

    @classmethod
    def of(cls, chain: Chain, frame: Frame, clock: Clock) -> FirstFrame:
        """Of a frame, while its volume is there, which is shown in the frame of the vectors."""
        camera, volume = chain.camera, chain.in_laboratory(frame.found.volume)
        words = "" if chain.space is None else " of the camera's own frame, in air"
        crops, views = raw_crops(frame.image, camera, frame.name), projections(volume)
        with clock("report"):
            light_field = decode(frame.image, chain.layout)
            stacks = [volume_stack(volume), *light_field_stacks(light_field, chain.lens_grid.limits_mm()[2], words)]
        return cls(crops, views, stacks)


class Shown:
    """The first frame of the first pair that can be measured, taken while it passes, or made again where that pair was
    finished before (``finished``: records by number)."""

    def __init__(
        self, chain: Chain, recording: Recording, clock: Clock, finished: Mapping[int, Mapping[str, Any]]
    ) -> None:
        self.chain, self.recording, self.clock = chain, recording, clock
        measured = [number for number, record in finished.items() if record["summaries"]]
        self._before = min(measured, default=len(recording.pairs))
        self._taken: tuple[int, FirstFrame] | None = None

    def see(self, number: int, frame: Frame | LostFrame) -> None:
        """Take the first frame of a pair, where no earlier one was measured."""
        if self.wants(number) and isinstance(frame, Frame):
            self._taken = number, FirstFrame.of(self.chain, frame, self.clock)

    def wants(self, number: int) -> bool:
        """Whether no earlier pair was measured."""
        return number < self._before and self._taken is None

    def take(self, number: int, first: FirstFrame) -> None:
        """Take what a worker made of the first frame of a pair."""
        self._taken = number, first

    def of(self, records: Sequence[Mapping[str, Any]], report: Progress) -> FirstFrame:
        """Of the first pair with summaries of its frames in ``records`` of all pairs."""
        first = next(record["pair"] for record in records if record["summaries"])
        if self._taken is None or self._taken[0] != first:
            frame = reconstructed(self.chain, self.recording, self.recording.pairs[first][0], report)
            self._taken = first, FirstFrame.of(self.chain, frame, self.clock)
        return self._taken[1]


class VolumeShown:
    """The same where there are volumes alone: the first frame's, taken while it passes or read again (``volume``)."""

    def __init__(self, chain: Chain, volume: Callable[[], SparseVolume], clock: Clock) -> None:
        self.chain, self.volume, self.clock = chain, volume, clock
        self._taken: tuple[int, FirstFrame] | None = None

    def see(self, number: int, volume: SparseVolume) -> None:
        """Take the first volume of a pair, where there was none before."""
        if self._taken is None:
            self._taken = number, self._shown(volume)

    def of(self, records: Sequence[Mapping[str, Any]], report: Progress) -> FirstFrame:
        """Of the first pair with summaries of its frames in ``records`` of all pairs."""
        first = next(record["pair"] for record in records if record["summaries"])
        if self._taken is None or self._taken[0] != first:
            self._taken = first, self._shown(self.volume())
        return self._taken[1]

    def _shown(self, volume: SparseVolume) -> FirstFrame:
        with self.clock("report"):
            volume = self.chain.in_laboratory(volume)
            return FirstFrame((), projections(volume), [volume_stack(volume)])
