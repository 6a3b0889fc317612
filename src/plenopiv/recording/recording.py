"""The frames of a recording, their pairs, and the images that calibrate them."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.recording.masks import Polygon, mask_of_image, mask_of_polygons
from plenopiv.recording.sources import ImageSource, only_source
from plenopiv.recording.static_light import StaticLight, static_light
from plenopiv.sensor import Orientation, Sensor, check_orientation, upright

SATURATED_SHARE = 1e-4  # above this a recording is warned about

NUMBERED = "number of the pair and a half, times dt_s"  # what the times of a double-frame camera's pairs are


@dataclass(frozen=True)
class Recording:
    """Frames, the pairs that they make, and the white image that shows where the microlenses are.

    ``frames``: sources or plain paths. ``dt_s``: between the two frames of a pair. ``pairs``: (first, second) numbers
    of frames; empty: a sequence, frames in the order of time and ``dt_s`` apart, each with the next. ``dark_path``: an
    image with the sensor covered. ``background_paths``: of the static light, one image, or of pairs one for each pulse.
    ``damaged``: why frames, by number, cannot be used, where others can: their pairs are lost.
    ``background_of_frames``: static light is to be estimated from the frames (``with_static_light``).
    ``mask``: an image that is 0 where pixels shall not be used, or polygons around these (``masks``).

    Raises:
        PlenoPIVError: an unknown orientation; a time that is not positive; fewer than two frames; the white image among
            them; two background images of a sequence of more than two; or a file that is missing, empty, of an unknown
            format, truncated, in colour, or of another size or depth than the sensor; of frames, where this leaves less
            than half of the pairs; or a mask that cannot be used. Only file headers are read for this, and the mask.
    """

    sensor: Sensor
    frames: tuple[ImageSource, ...]
    white_path: Path | None
    dt_s: float
    orientation: Orientation
    pairs: tuple[tuple[int, int], ...] = ()
    dark_path: Path | None = None
    background_paths: tuple[Path, ...] = ()
    background_of_frames: bool = False
    mask: Path | tuple[Polygon, ...] | None = None
    damaged: dict[int, str] = field(init=False, compare=False, default_factory=dict)

    def __repr__(self) -> str:
        names = self.names if len(self.names) < 4 else (self.names[0], "...", self.names[-1])
        white = "no white image" if self.white_path is None else f"white image {self.white_path.name}"
        return (
            f"<Recording {len(self.names)} frames ({', '.join(names)}), {len(self.pairs)} pairs, dt {self.dt_s:g} s,"
            f" {self.sensor.columns} x {self.sensor.rows} px, {self.orientation}, {white}>"
        )

    def __post_init__(self) -> None:
        check_orientation(self.orientation)
        if not 0 < self.dt_s < np.inf:
            raise PlenoPIVError(
                f"recording.dt_s: {self.dt_s} is no time between frames; give a positive number of seconds"
            )
        frames = tuple(f if isinstance(f, ImageSource) else only_source(Path(f)) for f in self.frames)
        object.__setattr__(self, "frames", frames)
        if len(frames) < 2:
            names = ", ".join(self.names) or "none"
            raise PlenoPIVError(f"recording.frames: {len(frames)} frame ({names}); a velocity needs at least two")
        if self.white_path in [frame.path for frame in frames]:
            raise PlenoPIVError(f"{self.white_path}: is named both in recording.white and in recording.frames")
        others = [*([self.white_source] if self.white_source else []), *map(only_source, self.calibration_paths)]
        for source in others:
            source.check(self.sensor)
        if not self.pairs:
            object.__setattr__(self, "pairs", tuple((k, k + 1) for k in range(len(frames) - 1)))
        if self.without_pulses and len(self.background_paths) > 1:
            raise PlenoPIVError(
                f"recording.background: two images belong to the two pulses of pairs, and the {len(frames)} frames are "
                "a sequence; name one image, or give the frames as recording.pairs"
            )
        object.__setattr__(self, "damaged", self._damaged())
        _ = self.masked

    def _damaged(self) -> dict[int, str]:
        """Frames whose headers are not those of an image of the sensor."""
        out: dict[int, str] = {}
        for k, source in enumerate(self.frames):
            try:
                source.check(self.sensor)
            except PlenoPIVError as error:
                out[k] = str(error)
                lost = sum(1 for pair in self.pairs if out.keys() & set(pair))
                if 2 * lost > len(self.pairs):
                    raise PlenoPIVError(next(iter(out.values()))) from None
        return out

    @property
    def is_sequence(self) -> bool:
        """Whether each frame follows the one before it after ``dt_s``."""
        return self.pairs == tuple((k, k + 1) for k in range(len(self.frames) - 1))

    @property
    def without_pulses(self) -> bool:
        """Whether frames are the second of one pair and the first of the next."""
        return self.is_sequence and len(self) > 2

    @property
    def calibration_paths(self) -> tuple[Path, ...]:
        """The dark image and those of static light, where there are any."""
        return (*([self.dark_path] if self.dark_path else []), *self.background_paths)

    @cached_property
    def static_light(self) -> StaticLight | None:
        """What frames hold beside the light of particles; None where no dark or background image is named. Without
        what is to be estimated from the frames.

        Raises:
            PlenoPIVError: an image cannot be used.
        """
        if not self.calibration_paths:
            return None
        pulses = self.backgrounds()
        return static_light(self.sensor, self.dark(), (pulses[0], pulses[-1]) if pulses else None)

    @cached_property
    def masked(self) -> NDArray[np.bool_] | None:
        """Pixels (rows, columns) of an upright image that ``mask`` leaves out; None without one.

        Raises:
            PlenoPIVError: as ``masks``.
        """
        if self.mask is None:
            return None
        stored = (
            mask_of_image(self.mask, self.sensor)
            if isinstance(self.mask, Path)
            else mask_of_polygons(self.mask, self.sensor)
        )
        return np.ascontiguousarray(upright(stored, self.orientation))

    @cached_property
    def unusable(self) -> NDArray[np.bool_] | None:
        """Pixels (rows, columns) of an upright image that are no equations: masked, hot, dead, or saturated by static
        light; None where there are none of these.

        Raises:
            PlenoPIVError: an image cannot be used, or no pixel is left.
        """
        static = self.static_light
        each = [part for part in (self.masked, None if static is None else static.unusable) if part is not None]
        if not each:
            return None
        together = np.logical_or.reduce(each)
        if together.all():
            raise PlenoPIVError("recording.mask: no pixel is left; the others are hot, dead or full of static light")
        return together

    def dark_level(self) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Counts of each pixel without light, and which pixels a dark image shows to be hot or dead.

        Raises:
            PlenoPIVError: the dark image cannot be used.
        """
        found = static_light(self.sensor, self.dark(), None)
        return found.dark, found.unusable

    def with_static_light(self, found: StaticLight) -> Recording:
        """The same, ``found`` taken off each frame."""
        other = copy(self)  # files are not looked at again
        other.__dict__.pop("unusable", None)
        other.__dict__.update(background_of_frames=False, static_light=found)
        return other

    def frames_of_pulses(self) -> list[list[int]]:
        """Numbers of the frames of the first pulse, and of the second; all in one list for a sequence."""
        if self.is_sequence:
            return [list(range(len(self)))]
        return [sorted({pair[pulse] for pair in self.pairs}) for pulse in (0, 1)]

    def light(self, k: int) -> tuple[NDArray, NDArray | None]:
        """Frame ``k`` without dark counts and static light, upright counts above the sensor's one black level, and the
        static light that was taken off; the frame as it is where there is neither.

        Raises:
            PlenoPIVError: as ``frame``.
        """
        counts, static = self.frame(k), self.static_light
        return (counts, None) if static is None else static.removed(counts, self.pulse(k))

    def mid_time_s(self, pair: int) -> float:
        """Time of a pair's vectors: from the recording's first frame in a sequence; of pairs, whose distances in time
        are not known, the pair's number in units of ``dt_s``, and half of it."""
        return (pair + 0.5) * self.dt_s

    @property
    def time_meaning(self) -> str:
        """What ``mid_time_s`` is, in the words of a file."""
        if self.is_sequence:
            return "mid-time of the two frames, from the first frame of the recording"
        return f"{NUMBERED}; the time between pairs is not known"

    def pulse(self, k: int) -> int:
        """0 for the first pulse of a pair, 1 for the second; 0 for all frames of a sequence of more than two."""
        return 0 if self.without_pulses else int(any(second == k for _, second in self.pairs))

    @property
    def names(self) -> list[str]:
        """Of the frames, as ``summary.json`` has them: of their files, with the folder, or else the frame's number from
        0, where others are called the same."""
        short = [frame.name for frame in self.frames]
        longer = [f"{frame.path.parent.name}/{frame.name}" for frame in self.frames]
        both, out = Counter(short), list[str]()
        of_longer = Counter(longer)
        for k, (name, other) in enumerate(zip(short, longer, strict=True)):
            out.append(name if both[name] == 1 else other if of_longer[other] == 1 else f"{other} ({k})")
        return out

    def stem(self, k: int) -> str:
        """What the names of files made of frame ``k`` hold; with its number where other frames are called the same."""
        stem = self.frames[k].stem
        return stem if sum(frame.stem == stem for frame in self.frames) == 1 else f"{stem}-{k}"

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, k: int) -> NDArray[np.uint16]:
        """Frame ``k`` as counts, upright, (rows, columns). Warns where more than 0.01 % of its pixels are saturated.

        Raises:
            PlenoPIVError: the pixels cannot be decoded, exceed the bit depth, or are all equal.
        """
        if k in self.damaged:
            raise PlenoPIVError(self.damaged[k])
        return self._image(self.frames[k])

    def first_readable_pair(self) -> tuple[tuple[int, int], dict[int, str]]:
        """The first pair of frames that can be read, and why others, by number, cannot: those ``damaged`` and those
        tried before it.

        Raises:
            PlenoPIVError: no pair can be read.
        """
        return self._readable_of(self.pairs)

    def last_readable_pair(self) -> tuple[tuple[int, int], dict[int, str]]:
        """The last pair, as ``first_readable_pair``."""
        return self._readable_of(self.pairs[::-1])

    def _readable_of(self, pairs: Sequence[tuple[int, int]]) -> tuple[tuple[int, int], dict[int, str]]:
        bad = dict(self.damaged)
        for pair in pairs:
            try:
                for k in pair:
                    self.frame(k)
            except PlenoPIVError as error:
                bad[k] = str(error)
                continue
            return pair, bad
        raise PlenoPIVError(next(iter(bad.values())))

    def white(self) -> NDArray[np.uint16] | None:
        """The white image, like ``frame``; None where the recording has none."""
        return None if self.white_source is None else self._image(self.white_source, mean=True)

    def dark(self) -> NDArray[np.uint16] | None:
        """Upright counts of the image with the sensor covered; None where the recording has none."""
        return None if self.dark_path is None else self._counts(only_source(self.dark_path), even=True, mean=True)

    def counts_of(self, path: Path) -> NDArray[np.uint16]:
        """Upright counts of another image of the same camera, as one of a target.

        Raises:
            PlenoPIVError: it cannot be used.
        """
        return self._counts(only_source(path), mean=True)

    def backgrounds(self) -> list[NDArray[np.uint16]]:
        """Upright counts of the static light, of both pulses or of each."""
        return [self._counts(only_source(path), even=True, mean=True) for path in self.background_paths]

    @cached_property
    def white_source(self) -> ImageSource | None:
        """Where the white image is; None where the recording has none."""
        return None if self.white_path is None else only_source(self.white_path)

    def _image(self, source: ImageSource, *, mean: bool = False) -> NDArray[np.uint16]:
        counts = self._counts(source, mean=mean)
        saturated = counts >= self.sensor.full_scale
        if self.masked is not None:
            saturated &= ~self.masked
        share = np.count_nonzero(saturated) / counts.size
        if share > SATURATED_SHARE:
            warnings.warn(
                f"{source}: {100 * share:.2g} % of the pixels are saturated ({self.sensor.full_scale} counts); their "
                f"light is underestimated",
                PlenoPIVWarning,
                stacklevel=3,
            )
        return counts

    def _counts(self, source: ImageSource, *, even: bool = False, mean: bool = False) -> NDArray[np.uint16]:
        return np.ascontiguousarray(upright(source.counts(self.sensor, even=even, mean=mean), self.orientation))
