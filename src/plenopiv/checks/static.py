"""Light that does not come from particles, and pixels that do not follow it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.checks.findings import Finding
from plenopiv.recording.static_light import StaticLight
from plenopiv.sensor import Sensor

UNEQUAL = 0.5  # of the other pulse's light below which a pulse is worth a warning
NEARLY_EQUAL = 0.9
TOP = 99.9  # per cent: the brightest pixels
FEWEST_PAIRS = 4  # whose common light is static: particles of fewer may overlap by chance
SPOT, USUAL = 3.0, 99.0  # times a particle in focus, and the brightest hundredth of what both frames share
SAME = 0.5  # of what one half shares that the other half shares where it is static; particles leave .4 at most
LEAST_COUNTS = 5.0
APART, LEAST_APART = 0.3, 10.0  # by which a dark image's counts may be off the black level: of that, and counts
WIDE, FILLED = 3.0, 0.75  # microlenses across a spot of saturated pixels, and their share: particles in focus fill one
MOST_FULL = 0.2  # of the pixels: a frame that has more is overexposed as a whole
FULL = 0.97  # of the highest count: after a dark image is taken off, saturated pixels differ
BLOCK_PITCHES = 8  # side of a block whose darkest pixels are looked at ...
DARKEST = 2.0  # ... per cent: particles leave these dark
GLOW = 0.1  # of a particle in focus, by which a block's may be lighter than most
DENSE = 0.6  # of what a quarter of its pixels stay below, that they hold at least: light of dense particles varies more
LIT = 0.5  # of the white image's bright pixels, that a pixel of a micro-image has
DIM = 25.0  # per cent: pixels without light of their own


MASK = (
    "mask it (recording.mask), or name images of the light without particles in recording.background: vectors near it "
    "are pulled toward zero"
)


def of_files(found: StaticLight, dark: str = "") -> list[Finding]:
    """What the dark image and those of static light show; ``dark``: the name of the first, where there is one."""
    out = []
    hot = int(np.count_nonzero(found.unusable))
    words = f"{hot} pixels are hot, dead or saturated by static light; they are left out"
    out.append(Finding("hot-pixels", "good", words, float(hot), "pixels"))
    if dark:
        out += _dark_level(dark, float(np.median(found.dark)), found.sensor)
    if found.pulses is not None:
        most = [float(np.percentile(light[~found.unusable], TOP)) for light in found.pulses]
        words = f"static light is taken off, up to {most[0]:.0f} counts of the first pulse, {most[1]:.0f} of the second"
        if min(most) > 0.5:
            out.append(Finding("static-light", "good", words, max(most), "counts"))
        else:  # noise alone leaves some
            advice = f"name images that were recorded as the frames are{_low_bits(found.sensor)}, or none"
            below = "an image in recording.background is darker than a pixel without light"
            out.append(Finding("static-light", "warning", f"{below}: {words}", min(most), "counts", advice))
    return out


def _dark_level(name: str, median: float, sensor: Sensor) -> list[Finding]:
    """A finding where a dark image is not of the black level that is stated, but of another gain, or in other bits."""
    level = sensor.black_level
    if level <= 0 or abs(median - level) <= max(APART * level, LEAST_APART):
        return []
    words = f"pixels of {name} hold {median:.0f} counts, where black_level = {level:g}"
    advice = f"is {name} of this camera, at the gain and exposure of the frames{_low_bits(sensor)}? Name one that is, "
    advice += f"or set camera.sensor.black_level = {median:.0f}"
    return [Finding("dark-level", "warning", words, median, "counts", advice)]


def _low_bits(sensor: Sensor) -> str:
    """What else may be wrong of files whose counts are in the upper bits."""
    return ", with counts in the upper bits too" if sensor.alignment == "high" else ""


def common_light(frames: list[NDArray], sensor: Sensor) -> Finding | None:
    """A finding where frames of different pairs, upright counts, share light that particles do not explain.

    The pixels at which the least count over one half of the frames is largest are looked up in the other half: static
    light is there again, light of particles that met by chance is not. A level that all pixels have is not of interest
    here.
    """
    if len(frames) < FEWEST_PAIRS:
        return None
    first, second = (np.minimum.reduce(half).astype(np.float32) for half in (frames[::2], frames[1::2]))
    both = [_again(first, second), _again(second, first)]
    seen, again = min(both, key=lambda each: each[1])
    if again < SAME * seen + LEAST_COUNTS:
        return None
    here = float(np.percentile(np.minimum(first, second), TOP)) - sensor.black_level
    return Finding(
        "static-light",
        "warning",
        f"static light: the brightest pixels hold {here:.0f} counts in every one of {len(frames)} frames of different "
        f"pairs, more than particles that meet by chance would leave",
        here,
        "counts",
        "record each pulse without particles and name the images in recording.background; vectors near it are pulled "
        "toward zero",
    )


def _again(one: NDArray, other: NDArray) -> tuple[float, float]:
    """Counts of one image where it is brightest, and of another one there: medians above each one's dim pixels."""
    there = one >= np.percentile(one, TOP)
    seen, again = (float(np.median(image[there]) - np.percentile(image, DIM)) for image in (one, other))
    return seen, again


def spot(a: NDArray, b: NDArray, sensor: Sensor, pitch_px: float, particle: float) -> Finding | None:
    """A finding where both frames of one pair (counts) hold a spot, under a microlens or more, that is far brighter
    than particles are, or wider than particles and saturated; ``particle``: counts of one in focus."""
    from scipy.ndimage import uniform_filter

    top = min(float(a.max()), float(b.max()))
    if top - sensor.black_level > 0.5 * (sensor.full_scale - sensor.black_level):
        full = np.minimum(a, b) >= FULL * top
        around = uniform_filter(full.astype(np.float32), round(WIDE * pitch_px))
        if around.max() > FILLED and np.mean(a >= FULL * top) < MOST_FULL:
            row, column = (int(k) for k in np.unravel_index(np.argmax(around), around.shape))
            words = f"static light: a spot of saturated pixels, {WIDE:.0f} microlenses wide or more, is in both frames"
            words += f" at (column, row) = ({column}, {row}): a reflection?"
            return Finding("static-light", "warning", words, top, "counts", MASK)
    both = uniform_filter(np.minimum(a, b).astype(np.float32), round(pitch_px)) - np.float32(sensor.black_level)
    top, usual = float(both.max()), float(np.percentile(both[::2, ::2], USUAL))
    if particle <= 0 or top < SPOT * max(particle, usual):
        return None
    row, column = (int(k) for k in np.unravel_index(np.argmax(both), both.shape))
    return Finding(
        "static-light",
        "warning",
        f"static light: a spot of {top:.0f} counts is in both frames at (column, row) = ({column}, {row}), where a "
        f"particle in focus gives {particle:.0f}: a reflection, or an aggregate?",
        top,
        "counts",
        f"if other frames have it too, {MASK}",
    )


def glow(
    a: NDArray, b: NDArray, white: NDArray | None, sensor: Sensor, pitch_px: float, particle: float
) -> Finding | None:
    """A finding where both frames of one pair (counts) are lighter in one part of the sensor than in most, also in
    pixels that particles leave dark. ``white``: counts of the white image, None without one: between micro-images
    there is no light; ``particle``: counts of one in focus."""
    if particle <= 0:
        return None
    side = round(BLOCK_PITCHES * pitch_px)
    rows, columns = (length // side for length in a.shape)
    both, level = np.minimum(a, b), np.full((2, rows, columns), np.nan)
    seen = None
    if white is not None:
        bright = np.percentile(white[::4, ::4], USUAL) - sensor.black_level
        seen = white >= sensor.black_level + LIT * bright
    for j, i in np.ndindex(rows, columns):
        block = slice(j * side, (j + 1) * side), slice(i * side, (i + 1) * side)
        own = both[block] if seen is None else both[block][seen[block]]
        if own.size >= 0.1 * side**2:
            level[:, j, i] = np.percentile(own, (DARKEST, DIM))
    if np.isnan(level).all():
        return None
    darkest, dim = level - np.nanmedian(level[0])
    j, i = (int(k) for k in np.unravel_index(np.nanargmax(darkest), darkest.shape))
    more = float(darkest[j, i])
    if more < max(GLOW * particle, LEAST_COUNTS, DENSE * float(dim[j, i])):
        return None
    row, column = (int((k + 0.5) * side) for k in (j, i))
    return Finding(
        "static-light",
        "warning",
        f"static light: around (column, row) = ({column}, {row}) no pixel of either frame is darker than {more:.0f} "
        f"counts above what most of the sensor has, where a particle in focus gives {particle:.0f}: a glow?",
        more,
        "counts",
        "keep stray light off the camera, or name images of it without particles in recording.background",
    )


def pulses(first: float, second: float) -> Finding:
    """The light of particles in the second frame over that in the first, mean counts above the background."""
    ratio = second / first if first > 0 else 0.0
    weaker = min(ratio, 1 / max(ratio, 1e-6))  # pulse, over the other
    words = f"the second pulse has {ratio:.2f} of the first one's light"
    if weaker < UNEQUAL:
        advice = "balance the pulses, or particles of the weaker one drown in the noise"
        return Finding("unequal-pulses", "warning", words, ratio, "", advice)
    name = "pulses" if weaker > NEARLY_EQUAL else "unequal-pulses"
    return Finding(name, "good", words, ratio)
