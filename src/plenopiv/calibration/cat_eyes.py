"""Micro-images that the rim of the main lens clips: cat's eyes, fitted by their uncut side.

Off the axis the rim of a lens lies beside the image of its stop. A micro-image is then what two discs share: the image
of the stop, of one radius under every microlens and about the chief ray; and that of the rim, whose middle is off by
``slip * position + start``. Its centroid is not the chief ray, but its uncut side still is where it was. Radii, blur
and slip are common to all and fitted to many micro-images at once; each has a centre, a gain, a background and light
that may be uneven (a ramp and a bow) of its own, eliminated lens by lens (Golub & Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.array_fit import LENSES_PER_TERM, ArrayFit, parameters
from plenopiv.calibration.micro_images import Disc, MicroImages
from plenopiv.calibration.spectrum import unit_centres
from plenopiv.cameras.plenoptic import LensRim, PlenopticCamera

PIXEL_BLUR = 1.0 / 12.0**0.5  # standard deviation of a pixel's width, px
CHUNK = 400_000  # pixels worked on at a time
SEARCH, FIT = 30_000, 120_000  # pixels of the micro-images that the first and the last fit take
RATIOS, SLIPS = (1.05, 1.2, 1.35), (-0.9, -0.45, 0.45, 0.9)  # radii of rim to stop, slip at the corner to the radius
SEARCH_STEPS, FIT_STEPS = 4, 12
CANDIDATES = 3  # that are followed up
ELONGATED_PX, ELONGATED = 0.015, 0.002  # elongation where a rim is sought: cut by 0.1 to 0.3 px it is .04 and .03
CLEARER = 0.99  # of what is left without a rim may be left with one that is believed
ALIKE = 1.005  # radius of the rim's image over the stop's: exactly equal ones are taken for the wrong way round ...
SWAPPED = 1.05  # ... unless the other way leaves so much more
LEAST_RADIUS_PX = 1.0  # of a spot whose edge can be told
LEAST_CLIPPED = 0.3  # share of the micro-images from which the others are predicted
LEAST_CUT_PX = 0.1  # at the farthest micro-image
STEPS = 10  # of each micro-image's fit
CONVERGED_PX = 0.01
NUISANCE = 7  # numbers of each micro-image: light, shift (2), background, ramp (2), bow

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rim:
    """Where the image of the lens' rim lies: its radius, and its middle from the chief ray of the micro-image at
    ``position`` (complex, pixels from the axis): slip * position + start; pixels."""

    radius_px: float
    slip: float
    start: complex

    def on_main_lens(self, camera: PlenopticCamera) -> LensRim:
        """The rim on the main lens; micro-images show it inverted."""
        px = camera.portion_mm  # mm on the main lens per pixel
        start = -px * self.start
        slip = -self.slip * (1.0 + camera.image_scale) / camera.image_scale
        return LensRim(self.radius_px * px, slip, (start.real, start.imag))

    def middle(self, position: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Middle of the rim's image from the chief ray, complex."""
        return np.asarray(self.slip * position + self.start)

    def cut_px(self, position: NDArray[np.complex128], disc: Disc) -> Array:
        """How deep the rim cuts into the stop's image; negative where it does not."""
        return np.abs(self.middle(position)) - (self.radius_px - disc.radius_px)


def _no_rim(disc: Disc) -> Rim:
    """A rim too wide to cut."""
    return Rim(10.0 * abs(disc.pitch), 0.0, 0j)


def light_of(dx: Array, dy: Array, disc: Disc, rim_px: float, middle: NDArray[np.complex128]) -> Array:
    """Light of pixels at (dx, dy) (lens, pixel) from the chief ray, and its derivatives, (11, lens, pixel): the light;
    by the chief ray's s and t; by the stop's radius, the blur, the rim's radius; by s and t of the rim's ``middle``
    (lens,); and the light that grows along s, along t and with the square of the radius. Neighbours' is in it."""
    from scipy.special import erfc

    width = float(np.hypot(disc.blur_px, PIXEL_BLUR))
    out = np.zeros((11, *dx.shape))
    for place in _lit_places(disc):
        near = np.hypot(dx[:1] - place.real, dy[:1] - place.imag)[0] < disc.radius_px + 3.5 * width + 1.5
        x, y = dx[:, near] - place.real, dy[:, near] - place.imag
        x2, y2 = x - middle.real[:, None], y - middle.imag[:, None]
        share, edge, over = [], [], []
        for a, b, radius in ((x, y, disc.radius_px), (x2, y2, rim_px)):
            r = np.maximum(np.hypot(a, b), 1e-9)
            far = (r - radius) / width
            share.append(0.5 * erfc(far / np.sqrt(2.0)))
            edge.append(np.exp(-0.5 * far**2) / (np.sqrt(2.0 * np.pi) * width))
            over.append((a / r, b / r, far))
        lit, by_stop, by_rim = _shared(share, over[0][0] * over[1][0] + over[0][1] * over[1][1])
        stop, rim = edge[0] * by_stop, edge[1] * by_rim
        out[0][:, near] += lit
        out[1][:, near] += stop * over[0][0] + rim * over[1][0]
        out[2][:, near] += stop * over[0][1] + rim * over[1][1]
        out[3][:, near] += stop
        out[4][:, near] += (stop * over[0][2] + rim * over[1][2]) * (disc.blur_px / width)
        out[5][:, near] += rim
        out[6][:, near] += rim * over[1][0]
        out[7][:, near] += rim * over[1][1]
        u, v = x / disc.reach_px, y / disc.reach_px
        for k, uneven in enumerate((u, v, u**2 + v**2), 8):
            out[k][:, near] += lit * uneven
    return out


def _shared(share: list[Array], cosine: Array) -> tuple[Array, Array, Array]:
    """What two blurred discs share, and its change with the share of each. ``cosine`` of the angle between their edges:
    of edges at right angles it is the product, of parallel ones the smaller; in between as where both are half lit
    (Sheppard's formula)."""
    a, b = share
    weight = (2.0 / np.pi) * np.arcsin(np.clip(cosine, -1.0, 1.0))
    same, across = np.maximum(weight, 0.0), 1.0 - np.abs(weight)
    against = np.maximum(-weight, 0.0)
    both = a + b - 1.0
    lit = across * a * b + same * np.minimum(a, b) + against * np.maximum(both, 0.0)
    kept, smaller = against * (both > 0), same * (a < b)
    return lit, across * b + smaller + kept, across * a + (same - smaller) + kept


def _lit_places(disc: Disc) -> list[complex]:
    """Centres of the micro-images that send light into the pixels of a fit, relative to its own."""
    places = [0j]
    if disc.radius_px + 2.5 * disc.blur_px > 0.5 * abs(disc.pitch) - 1.5:
        i, j = (a.ravel() for a in np.mgrid[-2:3, -2:3])
        numbers = unit_centres(disc.kind, i, j)
        places += list(disc.pitch * numbers[(np.abs(numbers) < 1.1) & (np.abs(numbers) > 0.1)])
    return places


def _windows(
    image: NDArray, position: NDArray[np.complex128], disc: Disc
) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Counts (lens, pixel) about positions, and the pixels' (s, t) from these; some lenses at a time."""
    half = disc.half_window
    rows, columns = image.shape
    d = np.arange(-half, half + 1)
    used = np.hypot(d, d[:, None]) < disc.reach_px + 0.5
    at_s, at_t = (a[used] for a in np.meshgrid(d, d))
    views = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))
    c = np.rint(position.real + (columns - 1) / 2.0).astype(int)
    r = np.rint(position.imag + (rows - 1) / 2.0).astype(int)
    step = max(1, CHUNK // at_s.size)
    for first in range(0, position.size, step):
        part = slice(first, first + step)
        counts = views[np.clip(r[part] - half, 0, len(views) - 1), np.clip(c[part] - half, 0, views.shape[1] - 1)]
        off_s = c[part] - (columns - 1) / 2.0 - position.real[part]
        off_t = r[part] - (rows - 1) / 2.0 - position.imag[part]
        yield part, counts[:, used].astype(np.float64), at_s + off_s[:, None], at_t + off_t[:, None]


def _own(light: Array) -> Array:
    """What each micro-image may change by itself, (lens, pixel, NUISANCE)."""
    return np.stack((light[0], light[1], light[2], np.ones_like(light[0]), *light[8:]), -1)


def measure_clipped(image: NDArray, position: NDArray[np.complex128], disc: Disc, rim: Rim) -> MicroImages:
    """Chief rays of the micro-images near ``position`` (complex, pixels from the axis), where the rim is known. Its cut
    may lie elsewhere under each microlens: what is fitted is the uncut side."""
    found, gain, quality = position.copy(), np.zeros(position.size), np.zeros(position.size)
    for _ in range(STEPS):
        moved = 0.0
        for part, counts, dx, dy in _windows(image, found, disc):
            middle = rim.middle(found[part])
            light = light_of(dx, dy, disc, rim.radius_px, middle)
            own = _own(light)
            cut = np.where(np.abs(light[5]).sum(1) > 0.02 * np.abs(light[3]).sum(1), 1.0, 0.0)
            design = np.concatenate((own, (cut[:, None] * light[5])[..., None]), -1)
            fit, left = _solved(design, counts)
            scale = np.where(np.abs(fit[:, 0]) > 1e-9, fit[:, 0], np.inf)
            shift = (fit[:, 1] + 1j * fit[:, 2]) / scale
            found[part] += shift * np.minimum(1.0, 1.0 / np.maximum(np.abs(shift), 1.0))
            gain[part] = fit[:, 0]
            total = np.sum((counts - counts.mean(1, keepdims=True)) ** 2, 1)
            quality[part] = 1.0 - left / np.maximum(total, 1e-30)
            moved = max(moved, float(np.quantile(np.abs(shift), 0.95)))
        if moved < CONVERGED_PX:
            break
    return MicroImages(found, gain, quality)


def chief_rays(
    image: NDArray, numbers: NDArray[np.complex128], position: NDArray[np.complex128], disc: Disc, rim: Rim
) -> MicroImages:
    """``measure_clipped`` begun where a fit to the least clipped micro-images says: deep cuts have moved ``position``
    so far that a fit begun there may end elsewhere. ``numbers`` of the lenses, on the unit lattice."""
    measured = measure_clipped(image, position, disc, rim)
    cut = rim.cut_px(measured.position, disc)
    least = cut <= max(float(np.quantile(cut, LEAST_CLIPPED)), 0.1 * disc.radius_px)
    for degree in (1, 3):
        good = least & (measured.quality > 0.5)
        if np.count_nonzero(good) < LENSES_PER_TERM * parameters(degree):
            break
        fit = ArrayFit.fitted(numbers[good], measured.position[good], degree)
        measured = measure_clipped(image, fit(numbers), disc, rim)
        least = np.ones(least.size, bool)
    return measured


def _solved(design: Array, counts: Array) -> tuple[Array, Array]:
    """Least-squares fits (lens, unknown) to counts (lens, pixel), and the squares that they leave (lens,)."""
    normal = np.einsum("lpa,lpb->lab", design, design, optimize=True)
    right = np.einsum("lpa,lp->la", design, counts, optimize=True)
    scale = np.sqrt(np.maximum(np.einsum("laa->la", normal), 1e-30))
    inverse = np.linalg.pinv(normal / (scale[:, :, None] * scale[:, None, :]), rcond=1e-9, hermitian=True)
    fit = np.einsum("lab,lb->la", inverse, right / scale) / scale
    return fit, np.sum((counts - np.einsum("lpa,la->lp", design, fit, optimize=True)) ** 2, 1)


def find_rim(image: NDArray, position: NDArray[np.complex128], disc: Disc) -> tuple[Disc, Rim] | None:
    """The stop's disc and the rim of micro-images near ``position``; None where they show no rim that clips them."""
    far, pixels = float(np.abs(position).max()), np.pi * (disc.reach_px + 0.5) ** 2
    few, many = (_spread(position, int(np.clip(most / pixels, 60, 1500))) for most in (SEARCH, FIT))
    (disc, _), without = refined(image, few, disc, None, 2 * SEARCH_STEPS)
    farthest, share = _elongation(image, many, disc)
    if farthest < ELONGATED_PX or share < ELONGATED:
        return None
    found = []
    for ratio in RATIOS:
        for slip in SLIPS:
            begun = Rim(ratio * disc.radius_px, slip * disc.radius_px / far, 0j)
            found.append(refined(image, few, disc, begun, SEARCH_STEPS))
    best = sorted(found, key=lambda each: each[1])[:CANDIDATES]
    (clipped, rim), left = min((refined(image, few, *each[0], FIT_STEPS) for each in best), key=lambda each: each[1])
    if rim is None or not left <= CLEARER * without < np.inf:
        return None
    (clipped, rim), left = refined(image, many, clipped, rim, FIT_STEPS)
    if rim is None or rim.cut_px(position, clipped).max() < LEAST_CUT_PX:
        return None
    if rim.radius_px < ALIKE * clipped.radius_px:  # of two discs alike either may be the stop's: the smaller one is
        swapped = Rim(1.02 * rim.radius_px, -rim.slip, -rim.start)
        (other, rim_2), left_2 = refined(image, many, clipped, swapped, FIT_STEPS)
        if rim_2 is not None and left_2 < left * (1.0 if rim_2.radius_px < ALIKE * other.radius_px else SWAPPED):
            return other, rim_2
    return clipped, rim


def _elongation(image: NDArray, position: NDArray[np.complex128], disc: Disc) -> tuple[float, float]:
    """Elongation of the micro-images as it changes evenly over the sensor: the largest, px of the radius, and its share
    of what a fit without a rim leaves. A rim's cut is seen in it first, and a look at it takes a tenth of the time of a
    search for the rim."""
    none, found = _no_rim(disc), []
    for part, counts, dx, dy in _windows(image, position, disc):
        light = light_of(dx, dy, disc, none.radius_px, none.middle(position[part]))
        own = _own(light)
        fit, left = _solved(own, counts)
        gain = np.maximum(fit[:, :1], 1e-9)
        rest = (counts - np.einsum("lpa,la->lp", own, fit)) / gain
        edge, turn = light[3], np.exp(2j * np.arctan2(dy, dx))
        power = 0.5 * np.maximum((edge**2).sum(1), 1e-30)
        found.append(np.stack([(rest * edge * turn).sum(1) / power, power, left / gain[:, 0] ** 2]))
    elongation, power, left = np.concatenate(found, 1)
    power, left = power.real, left.real
    good = left < 3.0 * np.median(left)
    at = position[good] / np.abs(position).max()
    terms = np.stack([at**i * at.conj() ** j for i in range(4) for j in range(4 - i)], -1)
    even = terms @ np.linalg.lstsq(terms, elongation[good], rcond=None)[0]
    change = np.abs(even - even.mean())
    return float(change.max()), float((change**2 * power[good]).sum() / left[good].sum())


def spot_disc(image: NDArray, position: NDArray[np.complex128], disc: Disc) -> tuple[Disc, Rim] | None:
    """Disc of spots near ``position``, and a rim that cuts none; None where they are too few pixels for a disc."""
    pixels = np.pi * (disc.reach_px + 0.5) ** 2
    few = _spread(position, int(np.clip(SEARCH / pixels, 60, 1500)))
    (found, _), _ = refined(image, few, disc, None, FIT_STEPS)
    return (found, _no_rim(disc)) if found.radius_px > LEAST_RADIUS_PX else None


def _spread(position: NDArray[np.complex128], count: int) -> NDArray[np.complex128]:
    """Some of the positions, all over the sensor; half of them of the outer third, where a rim clips."""
    order = np.random.default_rng(position.size).permutation(position.size)
    outer = np.abs(position[order]) >= np.quantile(np.abs(position), 2.0 / 3.0)
    half = min(count // 2, int(np.count_nonzero(outer)))
    return position[np.concatenate([order[outer][:half], order[~outer][: count - half]])]


def refined(
    image: NDArray, position: NDArray[np.complex128], disc: Disc, rim: Rim | None, steps: int
) -> tuple[tuple[Disc, Rim | None], float]:
    """Disc and rim by some steps of Gauss and Newton, and the squares left over those of the light, by the median lens;
    infinite where no micro-image has any light.

    Radii, blur, slip and its start are common; what is each micro-image's own is eliminated.
    """
    free = 2 if rim is None else 6
    at, left = position.copy(), np.inf
    for _ in range(steps):
        by = rim or _no_rim(disc)
        normal, right, ratios = np.zeros((free, free)), np.zeros(free), []
        for part, counts, dx, dy in _windows(image, at, disc):
            light = light_of(dx, dy, disc, by.radius_px, by.middle(at[part]))
            own = _own(light)
            fit, squares = _solved(own, counts)
            gain = fit[:, 0]
            if not (gain > 0).any():  # as of a rim begun where no light is
                continue
            ratio = squares / np.maximum(gain, 1e-9) ** 2
            good = (gain > 0.3 * np.median(gain)) & (ratio < 3.0 * np.median(ratio[gain > 0]))
            ratios.append(ratio[gain > 0])
            position_of = at[part][:, None]
            common = [light[3], light[4], light[5]]
            common += [light[6] * position_of.real + light[7] * position_of.imag, light[6], light[7]]
            slopes = np.stack(common[:free], -1)[good]
            rest = (counts - np.einsum("lpa,la->lp", own, fit))[good] / gain[good, None]
            slopes = slopes - _explained(own[good], slopes)
            normal += np.einsum("lpa,lpb->ab", slopes, slopes, optimize=True)
            right += np.einsum("lpa,lp->a", slopes, rest, optimize=True)
            shift = (fit[:, 1] + 1j * fit[:, 2]) / np.where(gain > 1e-9, gain, np.inf)
            at[part] += shift * np.minimum(1.0, 0.5 / np.maximum(np.abs(shift), 0.5))
        if not ratios:
            return (disc, rim), np.inf
        left = float(np.mean(np.sort(np.concatenate(ratios))[: max(1, int(0.8 * position.size))]))
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        step = np.linalg.solve(normal / np.outer(scale, scale) + 1e-6 * np.eye(free), right / scale) / scale
        before, by_before = disc, rim
        disc, rim = _moved(disc, rim, step, float(np.abs(at).max()))
        changes = [disc.radius_px - before.radius_px, disc.blur_px - before.blur_px]
        if rim is not None and by_before is not None:
            changes += [rim.radius_px - by_before.radius_px, (rim.slip - by_before.slip) * float(np.abs(at).max())]
        if np.abs(changes).max() < CONVERGED_PX:
            break
    return (disc, rim), left


def _explained(own: Array, slopes: Array) -> Array:
    """The part of slopes (lens, pixel, common) that what is each lens' own explains."""
    normal = np.einsum("lpa,lpb->lab", own, own, optimize=True)
    scale = np.sqrt(np.maximum(np.einsum("laa->la", normal), 1e-30))
    inverse = np.linalg.pinv(normal / (scale[:, :, None] * scale[:, None, :]), rcond=1e-9, hermitian=True)
    right = np.einsum("lpa,lpc->lac", own, slopes, optimize=True) / scale[..., None]
    return np.einsum("lpa,lac->lpc", own, (inverse @ right) / scale[..., None], optimize=True)


def _moved(disc: Disc, rim: Rim | None, step: Array, far: float) -> tuple[Disc, Rim | None]:
    """Disc and rim after a step, which is bounded."""
    pitch, most = abs(disc.pitch), 0.1 * disc.radius_px
    radius = float(np.clip(disc.radius_px + np.clip(step[0], -most, most), 0.05 * pitch, 0.7 * pitch))
    blur = float(np.clip(disc.blur_px + np.clip(step[1], -0.2, 0.2), 0.05, 0.25 * pitch))
    disc = replace(disc, radius_px=radius, blur_px=blur)
    if rim is None:
        return disc, None
    slip = rim.slip + float(np.clip(step[3], -2.0 * most / far, 2.0 * most / far))
    start = rim.start + complex(np.clip(step[4], -2 * most, 2 * most), np.clip(step[5], -2 * most, 2 * most))
    wide = rim.radius_px + float(np.clip(step[2], -2 * most, 2 * most))
    return disc, Rim(float(np.clip(wide, radius, 2.5 * radius)), slip, start)
