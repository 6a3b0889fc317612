"""The microlens lattice as its spectrum shows it: kind, pitch, rotation from the peaks, the offset from their phases.

Complex numbers stand for points of the plane, ``s + i t`` in pixels from the optical axis, and for wave vectors in
cycles per pixel. Lens ``w`` (``i + j sqrt(-1)`` for a square lattice) sits at ``offset + pitch * w`` with a complex
pitch ``|pitch| exp(i rotation)``; the reciprocal lattice is of the same kind, turned by 30 degrees if hexagonal.
"""

from __future__ import annotations

from cmath import exp, phase, pi
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.lattice import Lattice, LatticeKind

LARGEST_TRANSFORM = 2048  # pixels a side: peaks are then known to 1e-5 cycles per pixel
PEAK_OVER_MEDIAN = 6.0  # the largest of a million noise amplitudes is 4.5 medians high (Rayleigh)
SYMMETRY: dict[LatticeKind, int] = {"square": 4, "hexagonal": 6}
# Reciprocal of a lattice of unit pitch along the axis: its first vector.
RECIPROCAL: dict[LatticeKind, complex] = {"square": 1.0, "hexagonal": 2.0 / 3.0**0.5 * exp(1j * pi / 6.0)}
# Second vector of a lattice, and of its reciprocal, over the first.
STEP: dict[LatticeKind, complex] = {"square": 1j, "hexagonal": exp(1j * pi / 3.0)}
RINGS = {"square": (1, 2, 4, 5), "hexagonal": (1, 3, 4, 7)}  # squared lengths of reciprocal vectors over the first's
FACTOR = 2.2  # pitches within this factor of the stated one are searched


@dataclass(frozen=True)
class Peaks:
    """Peaks of a spectrum in one half plane: wave vectors (cycles per pixel), amplitudes, width of a bin."""

    waves: NDArray[np.complex128]
    amplitudes: NDArray[np.float64]
    bin: float


@dataclass(frozen=True)
class SpectralLattice:
    """A lattice read from the peaks: complex pitch in pixels and the share of the peaks' amplitude it explains."""

    kind: LatticeKind
    pitch: complex
    explained: float


def unit_centres(kind: LatticeKind, i: NDArray, j: NDArray) -> NDArray[np.complex128]:
    """Centres of lenses (i, j) of a lattice of unit pitch, as complex numbers."""
    s, t = Lattice(kind, 1.0).centres(i, j)
    return s + 1j * t


def _nearest(kind: LatticeKind, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return unit_centres(kind, *Lattice(kind, 1.0).nearest(z.real, z.imag))


def _central(image: NDArray, side: int) -> tuple[NDArray, NDArray, NDArray]:
    """The central part of an image without its mean under a Hann window, with s and t of its columns and rows."""
    rows, columns = image.shape
    n, m = min(side, rows), min(side, columns)
    r, c = (rows - n) // 2, (columns - m) // 2
    part = image[r : r + n, c : c + m].astype(np.float32)
    part -= part.mean()
    part *= np.outer(np.hanning(n), np.hanning(m)).astype(np.float32)
    return part, np.arange(c, c + m) - (columns - 1) / 2.0, np.arange(r, r + n) - (rows - 1) / 2.0


def find_peaks(image: NDArray, pitch_px: float, most: int = 60) -> Peaks:
    """Peaks that a lattice of roughly this pitch (within ``FACTOR``) would show, the strongest first.

    ``image`` has axes (t, s). Positions are refined by a parabola through the logarithms of three amplitudes.
    """
    from scipy import fft, ndimage

    part, _, _ = _central(image, LARGEST_TRANSFORM)
    amplitude = np.abs(fft.fftshift(fft.fft2(part)))
    ky, kx = (fft.fftshift(fft.fftfreq(n)) for n in part.shape)
    radius = np.hypot(ky[:, None], kx)
    ring = (radius > 0.9 / FACTOR / pitch_px) & (radius < min(0.47, 2.1 * FACTOR / pitch_px))
    half = (kx > 0) | ((kx == 0) & (ky[:, None] > 0))
    level = PEAK_OVER_MEDIAN * float(np.median(amplitude[ring])) if ring.any() else 0.0
    # A Hann window's side lobes have fallen to 0.3 % five bins from the peak.
    top = ring & half & (amplitude > level) & (amplitude == ndimage.maximum_filter(amplitude, 11))
    rows, columns = np.nonzero(top)
    order = np.argsort(-amplitude[rows, columns], kind="stable")[:most]
    rows, columns = rows[order], columns[order]
    peak = amplitude[rows, columns]
    keep = peak > 0.01 * peak[:1]
    rows, columns, peak = rows[keep], columns[keep], peak[keep].astype(float)

    def vertex(before: NDArray, after: NDArray) -> NDArray:
        b, p, a = (np.log(np.maximum(x, 1e-30)) for x in (before, peak, after))
        return 0.5 * (b - a) / np.minimum(b - 2 * p + a, -1e-9)

    dy = vertex(amplitude[rows - 1, columns], amplitude[rows + 1, columns]) / part.shape[0]
    dx = vertex(amplitude[rows, columns - 1], amplitude[rows, columns + 1]) / part.shape[1]
    return Peaks(kx[columns] + dx + 1j * (ky[rows] + dy), peak, 1.0 / min(part.shape))


def _explain(peaks: Peaks, kind: LatticeKind, first: complex) -> tuple[complex, float]:
    """Refine the first reciprocal vector on all peaks; also the share of amplitude within two bins of the lattice."""
    share = 0.0
    for _ in range(3):
        numbers = _nearest(kind, peaks.waves / first)
        good = (np.abs(peaks.waves - first * numbers) < 2.0 * peaks.bin) & (numbers != 0)
        share = float(peaks.amplitudes[good].sum() / peaks.amplitudes.sum())
        # Peaks along one line alone are stripes, not a lattice.
        if not good.any() or np.ptp(np.mod(np.angle(peaks.waves[good]), pi)) < 0.5:
            return first, 0.0
        w = peaks.amplitudes[good]
        first = complex(np.sum(w * np.conj(numbers[good]) * peaks.waves[good]) / np.sum(w * np.abs(numbers[good]) ** 2))
    return first, share


def read_lattice(peaks: Peaks, kind: LatticeKind, pitch_px: float, tolerance: float) -> SpectralLattice | None:
    """The lattice, of either kind, that explains the peaks; None where no lattice explains most of them.

    Each strong peak is tried as a member of each ring: of touching discs on a hexagonal lattice the second ring
    outshines the first, which almost vanishes. A lattice of a multiple of the pitch explains the peaks as well, and a
    few stray ones of dust besides, so that of the good explanations the smallest pitch is taken; but the stated kind
    and pitch (within ``tolerance``) stand where they do nearly as well and no smaller pitch does the same.
    """
    found: list[SpectralLattice] = []
    for trial, turn in RECIPROCAL.items():
        for number in (1.0, 1.0 + STEP[trial], 2.0):
            for wave in peaks.waves[:12]:
                first = complex(wave / number)
                if pitch_px / FACTOR < abs(turn / first) < FACTOR * pitch_px:
                    first, share = _explain(peaks, trial, first)
                    found.append(SpectralLattice(trial, _pitch_of(trial, first), share))
    best = max((f.explained for f in found), default=0.0)
    if best < 0.5:
        return None
    stated = [f for f in found if f.kind == kind and abs(abs(f.pitch) / pitch_px - 1.0) < tolerance]
    if stated:
        chosen = max(stated, key=lambda f: f.explained)
        simpler = [f for f in found if abs(f.pitch) < 0.9 * abs(chosen.pitch)]
        if chosen.explained > 0.9 * best and all(f.explained < 0.98 * chosen.explained for f in simpler):
            return chosen
    return min((f for f in found if f.explained >= 0.95 * best), key=lambda f: (round(abs(f.pitch), 2), -f.explained))


def _pitch_of(kind: LatticeKind, first: complex) -> complex:
    """Complex pitch of the lattice with this first reciprocal vector, its angle reduced by the lattice's symmetry."""
    ratio = first / RECIPROCAL[kind]
    return exp(1j * reduced_angle(kind, phase(ratio))) / abs(ratio)


def reduced_angle(kind: LatticeKind, angle_rad: float) -> float:
    """The same lattice's rotation in (-30, 30] degrees (hexagonal) or (-45, 45] (square)."""
    period = 2.0 * pi / SYMMETRY[kind]
    return angle_rad - period * float(np.ceil(angle_rad / period - 0.5))


def read_offset(image: NDArray, lattice: SpectralLattice) -> complex:
    """A micro-image's centre (complex, pixels) near the axis: the point of highest rotational symmetry.

    About the centre all waves of a ring have one and the same real coefficient, whatever its sign, which depends on
    the aperture: the squared sums over rings are greatest there. A square lattice has a second such point, in the gap
    between four discs, which is darker.
    """
    part, s, t = _central(image, 512)
    turn = RECIPROCAL[lattice.kind] * lattice.pitch / abs(lattice.pitch) ** 2
    i, j = (a.ravel() for a in np.mgrid[-3:4, -3:4])
    numbers = unit_centres(lattice.kind, i, j)
    norms = np.rint(np.abs(numbers) ** 2).astype(int)
    waves = turn * numbers
    rings = [waves[(norms == n) & (np.abs(waves) < 0.5)] for n in RINGS[lattice.kind]]
    rings = [
        (k, np.array([np.exp(-2j * pi * w.imag * t) @ part @ np.exp(-2j * pi * w.real * s) for w in k])) for k in rings
    ]

    def coherence(points: NDArray[np.complex128]) -> NDArray:
        total = np.zeros(points.shape)
        for k, c in rings:
            waves_at = np.exp(
                2j * pi * (np.multiply.outer(points.real, k.real) + np.multiply.outer(points.imag, k.imag))
            )
            total += np.abs(waves_at @ c) ** 2
        return total

    step = STEP[lattice.kind]
    centre, width = 0.0 + 0.0j, 1.0
    for cells in (32, 9, 9):
        u = np.linspace(-0.5, 0.5, cells) * width
        points = centre + lattice.pitch * (u[:, None] + step * u)
        centre = complex(points.ravel()[np.argmax(coherence(points))])
        width *= 2.0 / (cells - 1)
    if lattice.kind == "square":
        gap = centre + lattice.pitch * (0.5 + 0.5j)
        centre = max((centre, gap), key=lambda z: _brightness(image, lattice, z))
    return centre


def _brightness(image: NDArray, lattice: SpectralLattice, offset: complex) -> float:
    """Mean count within 0.25 pitches of the lattice's points, near the axis."""
    part, s, t = _central(image, 512)
    z = s + 1j * t[:, None] - offset
    unit = z / lattice.pitch
    return float(part[np.abs(unit - _nearest(lattice.kind, unit)) < 0.25].mean())
