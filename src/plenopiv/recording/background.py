"""Static light from the frames themselves: what every one of them shows, whatever the particles do.

The minimum of a pixel over the frames is where it starts: below the static light by the noise, above it where particles
light the pixel in nearly every frame. Both are corrected by maximum likelihood (``pixel_light``). Blocks of the sensor
without static light tell how the light of particles is distributed, and what is left of it in the estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.recording.pixel_light import BRIGHT, FEWEST, SLOWEST, PixelLight, noise_below_peak, peak, pixel_light
from plenopiv.recording.static_light import HOT, NEARLY_FULL, StaticLight
from plenopiv.sensor import Sensor

FRAMES = 60  # of each pulse that are used at most, spread over the recording
SCORINGS = 3  # steps of maximum likelihood, each of which reads the frames again
BLOCKS = 8  # along each side of the sensor; the quarter of them with the least static light shows the particles alone
SAMPLE = 200_000  # pixels on which distribution, pulses and errors are measured
CHUNK = 64  # rows at a time
ALIKE = 2.0  # times a pixel's noise that static light of both pulses may differ by, but for one factor
MOST_ALIKE = 0.4  # of the pixels; in the others the minimum of few frames holds light of particles
DARK = 1.5  # times the noise of the darkest block, of blocks without static light
MOST_LEFT, MOST_ERROR = 0.03, 0.15  # of the particles' mean light that the estimate may hold, and be off by (RMS)

Image = NDArray[np.float32]
Read = Callable[[int], NDArray[np.uint16]]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Estimate:
    """Static light of one pulse: ``counts`` above the dark level (rows, columns); ``hot`` pixels; the number of
    ``frames`` it was found from; ``error_counts`` of a pixel without static light; ``left_counts``: light of particles
    in it, on the mean; ``particles_counts``: that of a frame."""

    counts: Image
    hot: NDArray[np.bool_]
    frames: int
    error_counts: float
    left_counts: float
    particles_counts: float

    def scaled(self, factor: float) -> Estimate:
        """That of a pulse whose light is so many times as bright."""
        one = np.float32(factor)
        error, left, particles = self.error_counts, self.left_counts, self.particles_counts
        return replace(
            self,
            counts=one * self.counts,
            error_counts=factor * error,
            left_counts=factor * left,
            particles_counts=factor * particles,
        )


def static_light_of_frames(
    read: Read,
    pulses: Sequence[Sequence[int]],
    sensor: Sensor,
    dark: Image,
    counts_per_electron: float,
    unusable: NDArray[np.bool_],
    lit: NDArray[np.bool_],
    progress: Progress | None = None,
) -> tuple[StaticLight, list[Estimate]]:
    """Static light of both pulses from the frames of each; ``pulses``: numbers of the frames, one list for a sequence.

    ``read``: upright counts of a frame. ``dark`` (rows, columns): counts without light. ``unusable``: pixels left out.
    ``lit``: pixels under microlenses. Where static light of both pulses is the same but for one factor, both are found
    from the frames of both.

    Raises:
        PlenoPIVError: too few frames for their seeding: the estimate would hold light of particles.
    """
    chosen = [_spread(numbers) for numbers in pulses]
    total, done = sum(len(numbers) for numbers in chosen) * (1 + SCORINGS), 0

    def counted(number: int) -> Image:
        nonlocal done
        done += 1
        if progress:
            progress(done, total)
        counts = read(number)
        light = counts - dark
        light[counts >= sensor.full_scale] = np.inf
        return light

    pixels = np.flatnonzero(lit & ~unusable)
    pixels = pixels[:: max(1, len(pixels) // SAMPLE)]
    seen = [_Pulse.of(counted, numbers, pixels, counts_per_electron, float(sensor.full_scale)) for numbers in chosen]
    factor = _factor(seen[0], seen[1], counts_per_electron) if len(seen) == 2 else None
    if factor is not None:
        a = _estimate(counted, [(seen[0], 1.0), (seen[1], factor)], counts_per_electron)
        found = [a, a.scaled(factor)]
    else:
        found = [_estimate(counted, [(one, 1.0)], counts_per_electron) for one in seen]
    for one in found:
        if max(one.left_counts / MOST_LEFT, one.error_counts / MOST_ERROR) > one.particles_counts:
            raise PlenoPIVError(
                f'recording.background = "minimum": {one.frames} frames are too few for their seeding: where particles '
                f"give a pixel {one.particles_counts:.0f} counts on the mean, static light would be off by "
                f"{one.error_counts:.1f} (RMS) and hold {one.left_counts:.1f} of theirs; record more pairs, or each "
                "pulse without particles, and name those images"
            )
    a, b = found[0], found[-1]
    full = NEARLY_FULL * sensor.full_scale
    lost = unusable | a.hot | b.hot | (a.counts + dark >= full) | (b.counts + dark >= full)
    return StaticLight(sensor, dark, (a.counts, b.counts), lost, counts_per_electron), found


def _spread(numbers: Sequence[int]) -> list[int]:
    """At most ``FRAMES`` of them."""
    at = np.unique(np.rint(np.linspace(0, len(numbers) - 1, min(len(numbers), FRAMES))).astype(int))
    return [numbers[k] for k in at]


@dataclass(frozen=True)
class _Pulse:
    """The frames of one pulse, read once: the least of each pixel (rows, columns), counts of the sampled ``pixels`` in
    each (frame, pixel), which of them see no static light (``alone``), in which block each of those is, and where their
    noise lies (``level``)."""

    numbers: list[int]
    lowest: Image
    pixels: NDArray[np.intp]
    sample: Image
    alone: NDArray[np.bool_]
    block: NDArray[np.intp]
    level: Image
    light: PixelLight

    @classmethod
    def of(
        cls, read: Callable[[int], Image], numbers: list[int], pixels: NDArray[np.intp], gain: float, brightest: float
    ) -> _Pulse:
        """Read the frames, those left out that cannot be; no pixel is brighter than ``brightest`` counts."""
        lowest, sampled, used = np.array(brightest, np.float32), list[Image](), list[int]()
        for number in numbers:
            try:
                counts = read(number)
            except PlenoPIVError:  # its pair is set aside
                continue
            lowest = np.minimum(lowest, counts)
            sampled.append(counts.ravel()[pixels])
            used.append(number)
        if not used:
            raise PlenoPIVError('recording.background = "minimum": no frame of a pulse can be read')
        numbers, sample = used, np.stack(sampled)
        blocks, level = _dark_blocks(sample, pixels, lowest.shape)
        alone = blocks >= 0
        block = blocks[alone]
        level = level[block]
        counts = (sample[:, alone] - level).ravel()
        light = pixel_light(counts[np.isfinite(counts)], gain, float(np.percentile(lowest, 99.9)))
        return cls(numbers, lowest, pixels, sample, alone, block, level, light)

    def start(self, gain: float, frames: int) -> Image:
        """The minimum, corrected for what the least of so many ``frames`` is on the mean."""
        least = self.light.lowest(frames).astype(np.float32)
        return self.lowest - least[self.light.level(_std(self.lowest, self.light, gain))]


def _std(static: Image, light: PixelLight, gain: float) -> Image:
    """Noise of pixels with static light, counts."""
    return np.sqrt(np.maximum(gain * static, 0.0) + np.float32(light.noise**2)).astype(np.float32)


def _estimate(read: Callable[[int], Image], pulses: list[tuple[_Pulse, float]], gain: float) -> Estimate:
    """Of the first of the pulses, each with the factor of its static light over the first one's."""
    one, frames = pulses[0][0], sum(len(pulse.numbers) for pulse, _ in pulses)
    for pulse, factor in pulses[1:]:
        one = replace(one, lowest=np.minimum(one.lowest, pulse.lowest / np.float32(factor)))
    static = one.start(gain, frames)
    for _ in range(SCORINGS):
        slope, information = np.zeros_like(static), np.zeros_like(static)
        for pulse, factor in pulses:
            light = pulse.light
            rows = light.level(_std(np.float32(factor) * static, light, gain))
            bright, theirs = np.float32(factor) * static.ravel()[pulse.pixels], rows.ravel()[pulse.pixels]
            for n, number in enumerate(pulse.numbers):
                scale = np.float32(factor * light.brightness(pulse.sample[n], bright, theirs)[0])
                counts = read(number)
                for top in range(0, static.shape[0], CHUNK):
                    part = slice(top, top + CHUNK)
                    by_noise = scale / light.stds[rows[part]].astype(np.float32)
                    slope[part] += by_noise * light.scores(counts[part] - scale * static[part], rows[part])
                    information[part] += by_noise**2 * light.information[rows[part]].astype(np.float32)
        most = SLOWEST * _std(static, one.light, gain)
        static += np.clip(slope / information, -most, most)
    alone = static.ravel()[one.pixels][one.alone] - one.level
    hot = _hot(static, one.light.noise)
    cold = ~hot.ravel()[one.pixels][one.alone]
    each = [alone[cold & (one.block == b)] for b in np.unique(one.block)]
    each = [counts for counts in each if counts.size]
    # of most blocks: the rim of a bright reflection may lie in one that counts as dark
    error, left = float(np.median([np.std(counts) for counts in each])), float(np.median([c.mean() for c in each]))
    left = max(left, 0.0)
    return Estimate(static, hot, frames, error, left, one.light.particles)


def _hot(static: Image, noise: float) -> NDArray[np.bool_]:
    """Pixels far brighter than any next to them, as no lens images: they follow no pulse."""
    from scipy.ndimage import maximum_filter

    around = np.ones((3, 3), bool)
    around[1, 1] = False
    return static - maximum_filter(static, footprint=around) > np.maximum(HOT * noise, static / 2)


def _dark_blocks(sample: Image, pixels: NDArray, shape: tuple[int, ...]) -> tuple[NDArray, Image]:
    """Of each sampled pixel its block, -1 in blocks that hold static light; and where the noise of each block lies,
    counts. At least a quarter of the blocks count as without it."""
    row, column = np.unravel_index(pixels, shape)
    block = (row * BLOCKS // shape[0]) * BLOCKS + column * BLOCKS // shape[1]
    level, spread = np.full(BLOCKS**2, np.inf, np.float32), np.full(BLOCKS**2, np.inf)
    for b in np.unique(block):
        counts = sample[:, block == b].ravel()
        level[b] = peak(counts)
        spread[b] = noise_below_peak(counts - level[b])
    light = np.hypot(level - level.min(), spread)  # a gradient within the block widens the noise
    darkest = np.sort(light)[BLOCKS**2 // 4]
    return np.where((light <= max(darkest, DARK * light.min()))[block], block, -1), level


def _factor(a: _Pulse, b: _Pulse, gain: float) -> float | None:
    """Static light of the second pulse over that of the first, from the sampled pixels; None where it is not the same
    but for a factor, or nowhere bright enough to tell."""
    first, second = (np.sort(one.sample, 0)[: max(len(one.sample) // 10, 1)].mean(0) for one in (a, b))
    bright = (first > BRIGHT * a.light.noise) & (second > BRIGHT * b.light.noise)  # in one alone: light of particles
    bright &= np.isfinite(first) & np.isfinite(second)
    if np.count_nonzero(bright) < FEWEST:
        return None
    first, second = first[bright], second[bright]
    ratio = np.sort(second / first)
    share = len(ratio) // 5  # the densest fifth: where the minimum of neither pulse holds light of a particle
    k = int(np.argmin(ratio[share:] - ratio[:-share]))
    factor = float(np.median(ratio[k : k + share]))
    noise = np.sqrt(gain * np.maximum(second, 0.0) * (1 + factor) + b.light.noise**2 + (factor * a.light.noise) ** 2)
    alike = float(np.mean(np.abs(second - factor * first) < ALIKE * noise))
    return factor if factor > 0 and alike > MOST_ALIKE else None
