"""Each pair of a run as it comes: what spoils one pair of a recording that is good otherwise.

Cheap against a reconstruction: light by blocks of the sensor, the white image's microlenses, saturation.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.checks import fit, light, outlines, repeats, static
from plenopiv.checks.findings import Finding
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning, printable
from plenopiv.recording import Recording
from plenopiv.sensor import Sensor, without

BLOCK = 5.0  # pitches: the least side of a block whose light is compared
MOST_BLOCKS = 8  # along each side
DARK = 0.25  # of what the other blocks make of it: a block that lost its light
SHARE = 0.1  # of the blocks, from which a frame counts as partly dark
FAINT = 0.2  # of the median block's light, below which a block tells nothing

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class PairCheck:
    """What pairs of one recording are compared with: the upright white image (rows, columns), in counts, or None, and
    the ``camera`` with its lattice. ``unusable``: pixels (rows, columns) that are no equations, None for none."""

    sensor: Sensor
    white: NDArray | None
    camera: PlenopticCamera
    unusable: NDArray[np.bool_] | None = None

    def findings(self, images: tuple[NDArray, NDArray], names: tuple[str, str]) -> list[Finding]:
        """Findings that are not good on both upright frames, in counts."""
        a, b = images = without(images[0], self.unusable, self.sensor), without(images[1], self.unusable, self.sensor)
        if repeats.same_image(a, b, self.sensor):
            words = f"{names[0]} and {names[1]} are one image, down to its noise: nothing moves between them"
            return [Finding("same-frame", "unusable", words, advice="copy the frames again")]
        out = [light.clipping(image, self.sensor, name) for image, name in zip(images, names, strict=True)]
        out += self._of_white(images, names)
        out += [found for found in (self._partly_dark(images, names),) if found is not None]
        level = self.sensor.black_level
        out.append(static.pulses(*(max(float(image.mean()) - level, 0.0) for image in images)))
        return [finding for finding in out if finding.severity != "good"]

    def _of_white(self, images: tuple[NDArray, NDArray], names: tuple[str, str]) -> list[Finding]:
        """Frames that were turned or mirrored, or whose microlenses lie elsewhere."""
        if self.white is None:
            return []
        level, pitch_px = self.sensor.black_level, self.camera.image_pitch_px
        out = []
        seen = fit.fits(images, self.white, pitch_px, level, ("as it is",))
        for image, name, found in zip(images, names, seen, strict=True):
            if found.agreement["as it is"] < fit.FITS:
                found = fit.fits([image], self.white, pitch_px, level)[0]
            of_frame = fit.finding(found, name)
            out.append(outlines.settled(of_frame, image, name, self.white, self.camera, self.unusable))
        return out

    def _partly_dark(self, images: tuple[NDArray, NDArray], names: tuple[str, str]) -> Finding | None:
        """A finding where a part of one frame lost the light that the other one has there."""
        count = int(np.clip(min(images[0].shape) / (BLOCK * self.camera.image_pitch_px), 1, MOST_BLOCKS))
        one, other = (_light_of_blocks(image - np.float32(self.sensor.black_level), count) for image in images)
        clear = np.maximum(one, other) > FAINT * np.median(np.maximum(one, other))
        if count < 2 or not clear.any() or min(np.median(one[clear]), np.median(other[clear])) <= 0:
            return None
        for name, lit, less in ((names[0], other, one), (names[1], one, other)):
            bright = clear & (lit > FAINT * np.median(lit[clear]))
            ratio = less[bright] / lit[bright]
            if ratio.size and np.mean(ratio < DARK * np.percentile(ratio, 75)) > SHARE:
                dark = 100 * float(np.mean(ratio < DARK * np.percentile(ratio, 75)))
                words = f"{dark:.0f} % of {name} is dark where the other frame of its pair shows particles"
                advice = "a shutter, a beam that was cut, or a file that was not written whole; leave the pair out"
                return Finding("partly-dark", "unusable", words, dark, "%", advice)
        return None


def every_pair(recording: Recording, check: PairCheck, progress: Progress | None = None) -> list[Finding]:
    """Read all frames: of each kind of finding the worst of the first pair that has it, and how many pairs have it."""
    found: dict[tuple[str, str], list[Finding]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)  # saturation is a finding here
        for number, (a, b) in enumerate(recording.pairs):
            names = (printable(recording.frames[a].name), printable(recording.frames[b].name))
            try:
                of_pair = check.findings((recording.frame(a), recording.frame(b)), names)
            except PlenoPIVError as error:
                of_pair = [Finding("damaged-frame", "warning", str(error), advice="a run sets its pair aside")]
            for finding in of_pair:
                found.setdefault((finding.name, finding.severity), []).append(finding)
            if progress:
                progress("all pairs", number + 1, len(recording.pairs))
    out = []
    for (name, severity), all_of_it in found.items():
        first, count = all_of_it[0], len(all_of_it)
        spoilt = severity == "unusable"
        alone = f" (1 of {len(recording.pairs)} pairs)" if count == 1 else f" ({count} of {len(recording.pairs)} pairs)"
        advice = f"{first.advice}; a run sets such pairs aside" if spoilt else first.advice
        whole = spoilt and count == len(recording.pairs)
        out.append(
            Finding(name, "unusable" if whole else "warning", first.words + alone, float(count), "pairs", advice)
        )
    return out or [Finding("all-pairs", "good", f"all {len(recording.pairs)} pairs were read and nothing stands out")]


def _light_of_blocks(image: NDArray, count: int) -> NDArray[np.float64]:
    """Mean light of count x count blocks."""
    rows, columns = (np.linspace(0, n, count + 1).astype(int) for n in image.shape)
    sums = np.add.reduceat(np.add.reduceat(image, rows[:-1], 0, dtype=np.float64), columns[:-1], 1)
    return sums / np.outer(np.diff(rows), np.diff(columns))
