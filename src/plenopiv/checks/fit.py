"""Whether the light of the frames falls where the white image has its microlenses.

Whatever the flow, particles light only pixels under microlenses: summed over many of them a frame repeats the pattern
of the white image, gaps between micro-images dark. Both images without their slowly varying part are correlated in
blocks of some microlenses, within half a pitch around no shift. ``agreement`` is the correlation at no shift over the
highest one, summed over the blocks: 1 where the frame's microlenses are the white image's, near 0 or negative where
they lie elsewhere. Blocks beside the lit volume are left out: what light they get comes from far out of focus and from
one side, and lights one side of every micro-image.

Repeated with the white image turned and mirrored, the comparison shows in which orientation one of them was saved. It
cannot where the lattice is the same after the turn, to a fraction of a pixel; then all views are the same, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil

import numpy as np
from numpy.typing import NDArray

from plenopiv.checks.findings import Finding

FITTING = "white-fits-frames"  # names of findings
MOVED = "white-moved"
OTHER_CAMERA = "other-camera"
BLOCK = 20.0  # pitches
MOST_BLOCKS = 64
LIT = 0.2  # of the light of the brightest block: with less, a block is beside the lit volume
FITS = 0.75  # agreement: above, the lattice is the frame's; one pixel of 14 off leaves 0.63
CLEARLY = 0.92  # and of the orientation that is named instead
MOVED_PX = 0.4  # median shift that is worth a warning; noise makes up to 0.1
FEWEST = 0.02  # correlation coefficient at the highest place below which a frame shows no microlenses

TURNS: dict[str, Callable[[NDArray], NDArray]] = {
    "as it is": lambda image: image,
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
    "turned by 90 degrees counter-clockwise": lambda image: np.rot90(image),
    "turned by 90 degrees clockwise": lambda image: np.rot90(image, -1),
    "mirrored about a diagonal": lambda image: image.T,
    "mirrored about the other diagonal": lambda image: np.rot90(image, 2).T,
}


@dataclass(frozen=True)
class Fit:
    """How a frame's microlenses lie to the white image's.

    ``agreement`` by the way in which the white image was turned; ``visible`` the correlation coefficient at the highest
    place; ``centres_px`` (n, 2) columns and rows of lit blocks and ``shifts_px`` (n, 2) by how much the frame's pattern
    is off there to the right and down, within half a pitch.
    """

    agreement: dict[str, float]
    visible: float
    centres_px: NDArray[np.float64]
    shifts_px: NDArray[np.float64]

    @property
    def shift_px(self) -> float:
        """Median length of the blocks' shifts."""
        return float(np.median(np.hypot(*self.shifts_px.T)))


def fit(frame: NDArray, white: NDArray, pitch_px: float) -> Fit:
    """Compare an upright frame with an upright white image, both (rows, columns) in counts above the black level."""
    return fits([frame], white, pitch_px)[0]


def fits(
    frames: Sequence[NDArray],
    white: NDArray,
    pitch_px: float,
    black_level: float = 0.0,
    turns: Sequence[str] = tuple(TURNS),
) -> list[Fit]:
    """``fit`` of several frames, in counts, the white image turned in each of ``turns``; it is transformed once for all
    of them."""
    blocks = _blocks(frames[0].shape, pitch_px)
    cut = partial(_pattern, side=blocks.side, pitch_px=pitch_px, black_level=black_level)
    light = [[cut(frame, corner, most=3.0) for corner in blocks.corners] for frame in frames]
    lit = np.array([blocks.lit(frame, black_level) for frame in frames])
    agreement: list[dict[str, float]] = [{} for _ in frames]
    visible, shifts = np.zeros(len(frames)), np.zeros((len(frames), len(blocks.corners), 2))
    for name in turns:
        turned = TURNS[name](white)
        if turned.shape != frames[0].shape:
            continue
        sums = np.zeros((3, len(frames)))  # at no shift, at the highest place, and what that could be
        for k, corner in enumerate(blocks.corners):
            lens = cut(turned, corner, most=1.0)
            for n in np.flatnonzero(lit[:, k]).tolist():
                parts = light[n]
                at, top, shift = _correlated(parts[k], lens, pitch_px)
                sums[:, n] += at, top, parts[k].norm * lens.norm
                if name == "as it is":
                    shifts[n, k] = shift
        for n, (here, highest, weight) in enumerate(sums.T):
            agreement[n][name] = float(here / highest) if highest > 0 else 0.0
            visible[n] = max(visible[n], highest / weight if weight > 0 else 0.0)
    centres = np.array([(c + blocks.side / 2, r + blocks.side / 2) for r, c in blocks.corners])
    found = zip(agreement, visible, shifts, lit, strict=True)
    return [Fit(a, float(v), centres[here], s[here]) for a, v, s, here in found]


def fitting(name: str, shift_px: float) -> Finding:
    """The good finding on frame ``name``."""
    return Finding(FITTING, "good", f"the light of {name} falls under the white image's microlenses", shift_px, "px")


def finding(found: Fit, name: str) -> Finding:
    """The finding on frame ``name``."""
    given = found.agreement["as it is"]
    if given >= FITS and found.shift_px > MOVED_PX:
        return Finding(
            MOVED,
            "warning",
            f"the microlenses of {name} lie {found.shift_px:.1f} px off those of the white image",
            found.shift_px,
            "px",
            'lens or array moved a little since; take a new white image, or set recording.drift = "auto"',
        )
    if given >= FITS:
        return fitting(name, found.shift_px)
    if found.visible < FEWEST:
        return Finding(
            FITTING,
            "warning",
            f"{name} shows no microlenses: whether the white image fits is unknown",
            found.visible,
            advice="more particles or more light; or the frames are blurred or were filtered",
        )
    other = max((turn for turn in found.agreement if turn != "as it is"), key=found.agreement.__getitem__)
    if found.agreement[other] >= CLEARLY:
        return Finding(
            "flipped",
            "unusable",
            f"the white image fits {name} only {other}: one of them was saved turned or mirrored",
            found.shift_px,
            "px",
            "save white image and frames in the same way, then check recording.orientation with a printed letter "
            "(docs/frame-and-units.md)",
        )
    return Finding(
        OTHER_CAMERA,
        "unusable",
        f"the microlenses of {name} lie {found.shift_px:.1f} px (median, within half a pitch) off those of the white "
        "image, in no orientation nearer: it is another camera's, or lens or array have moved since",
        found.shift_px,
        "px",
        "take a new white image with the settings of these frames",
    )


@dataclass(frozen=True)
class _Blocks:
    side: int
    corners: list[tuple[int, int]]

    def lit(self, frame: NDArray, black_level: float) -> NDArray[np.bool_]:
        """Which blocks have light of the volume."""
        light = np.array([float(frame[r : r + self.side, c : c + self.side].mean()) for r, c in self.corners])
        return (light - black_level >= LIT * (light.max() - black_level)) | (light == light.max())


def _blocks(shape: tuple[int, int], pitch_px: float) -> _Blocks:
    """Square blocks spread evenly over an image, to its corners."""
    side = int(min(BLOCK * pitch_px, *shape))
    counts = [ceil(length / side) for length in shape]
    most = int(np.sqrt(MOST_BLOCKS))
    rows, columns = (
        np.linspace(0, length - side, min(n, most)).astype(int) for length, n in zip(shape, counts, strict=True)
    )
    return _Blocks(side, [(int(r), int(c)) for r in rows for c in columns])


@dataclass(frozen=True)
class _Pattern:
    """Spectrum of a block's pattern, and the root of its sum of squares."""

    spectrum: NDArray[np.complex128]
    norm: float


def _pattern(
    image: NDArray, corner: tuple[int, int], *, side: int, pitch_px: float, black_level: float, most: float
) -> _Pattern:
    """A block of an image over its local mean, without its mean; so bright particles count no more than others."""
    from scipy.ndimage import gaussian_filter

    row, column = corner
    block = image[row : row + side, column : column + side] - float(black_level)
    slow = gaussian_filter(block, 1.2 * pitch_px, mode="nearest")
    floor = max(0.2 * float(slow.mean()), 1e-9)
    ratio = np.clip((block - slow) / np.maximum(slow, floor), -1.0, most)
    ratio -= ratio.mean()
    return _Pattern(np.fft.rfft2(ratio), float(np.linalg.norm(ratio)))


def _correlated(frame: _Pattern, white: _Pattern, pitch_px: float) -> tuple[float, float, NDArray[np.float64]]:
    """Correlation at no shift, the highest within half a pitch, and the shift of that (right, down) in pixels."""
    side = frame.spectrum.shape[0]
    product = np.fft.irfft2(frame.spectrum * np.conj(white.spectrum), (side, side))
    reach = int(0.5 * pitch_px + 1)
    step = np.arange(-reach, reach + 1)
    near = product[np.ix_(step, step)]
    near = np.where(np.hypot(step[:, None], step) <= 0.5 * pitch_px + 1, near, -np.inf)
    row, column = np.unravel_index(np.argmax(near), near.shape)
    top = float(near[row, column])
    shift = [float(step[column]), float(step[row])]
    for axis, (line, k) in enumerate(((near[row], column), (near[:, column], row))):
        if 0 < k < len(line) - 1 and np.isfinite(line[k - 1 : k + 2]).all():
            left, right = line[k - 1], line[k + 1]
            curve = left - 2 * top + right
            shift[axis] += 0.5 * float((left - right) / curve) if curve < 0 else 0.0
    return float(product[0, 0]), top, np.array(shift)
