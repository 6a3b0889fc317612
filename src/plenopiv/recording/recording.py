"""The frames of a recording, their pairs, and the images that calibrate them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.recording.sources import ImageSource, only_source
from plenopiv.sensor import Orientation, Sensor, upright

SATURATED_SHARE = 1e-4  # above this a recording is warned about


@dataclass(frozen=True)
class Recording:
    """Frames, the pairs that they make, and the white image that shows where the microlenses are.

    ``frames``: sources or plain paths. ``dt_s``: between the two frames of a pair. ``pairs``: (first, second) numbers
    of frames; empty: a sequence, frames in the order of time and ``dt_s`` apart, each with the next.

    Raises:
        PlenoPIVError: fewer than two frames; the white image among them; or a file that is missing, empty, of an
            unknown format, truncated, in colour, or of another size or depth than the sensor. Only file headers are
            read for this.
    """

    sensor: Sensor
    frames: tuple[ImageSource, ...]
    white_path: Path | None
    dt_s: float
    orientation: Orientation
    pairs: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        frames = tuple(f if isinstance(f, ImageSource) else only_source(f) for f in self.frames)
        object.__setattr__(self, "frames", frames)
        if len(frames) < 2:
            names = ", ".join(self.names) or "none"
            raise PlenoPIVError(f"recording.frames: {len(frames)} frame ({names}); a velocity needs at least two")
        if self.white_path in [frame.path for frame in frames]:
            raise PlenoPIVError(f"{self.white_path}: is named both in recording.white and in recording.frames")
        for source in (*frames, *([self._white] if self._white else [])):
            source.check(self.sensor)
        if not self.pairs:
            object.__setattr__(self, "pairs", tuple((k, k + 1) for k in range(len(frames) - 1)))

    @property
    def is_sequence(self) -> bool:
        """Whether each frame follows the one before it after ``dt_s``."""
        return self.pairs == tuple((k, k + 1) for k in range(len(self.frames) - 1))

    @property
    def names(self) -> list[str]:
        """Of the frames, as messages and ``summary.json`` have them."""
        return [frame.name for frame in self.frames]

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, k: int) -> NDArray[np.uint16]:
        """Frame ``k`` as counts, upright, (rows, columns). Warns where more than 0.01 % of its pixels are saturated.

        Raises:
            PlenoPIVError: the pixels cannot be decoded, exceed the bit depth, or are all equal.
        """
        return self._image(self.frames[k])

    def white(self) -> NDArray[np.uint16] | None:
        """The white image, like ``frame``; None where the recording has none."""
        return None if self._white is None else self._image(self._white)

    @property
    def _white(self) -> ImageSource | None:
        return None if self.white_path is None else only_source(self.white_path)

    def _image(self, source: ImageSource) -> NDArray[np.uint16]:
        counts = source.counts(self.sensor)
        share = np.count_nonzero(counts >= self.sensor.full_scale) / counts.size
        if share > SATURATED_SHARE:
            warnings.warn(
                f"{source}: {100 * share:.2g} % of the pixels are saturated ({self.sensor.full_scale} counts); their "
                f"light is underestimated",
                PlenoPIVWarning,
                stacklevel=3,
            )
        return np.ascontiguousarray(upright(counts, self.orientation))
