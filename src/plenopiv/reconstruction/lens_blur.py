"""How far the main lens blurs, from the particles of one frame.

Particles strewn at random correlate pixels that they light together (Campbell's theorem). Pixels a lag of microlenses
apart, in two views a baseline of portions apart, share

    C(lag, baseline) = sum_z n(z) a(move(z) baseline - lag),    a: the autocorrelation of a plane's weights,

up to a factor, n(z) >= 0 the particles and their light squared in plane z. The baseline tells planes apart by the shift
of the correlation, and a is the wider the further the main lens blurs: convolved with a Gaussian of sqrt(2) times its
standard deviation. For each standard deviation the best n(z) is found by non-negative least squares, and the standard
deviation that leaves the least is the blur. Views differ in every baseline, so that noise of the pixels adds nothing.

Where light ends, because a laser sheet is narrower than the volume, say, pixels correlate over all lags, the less the
further they are apart, and that looks like blur. So microlenses near such edges are left out, and the mean light about
each pixel is taken off. What is still common to all lags is left out too. A saturated pixel does not show how bright
the middle of a particle is, which then looks wider; its microlens and those beside it are left out, where these are
few: a few particles far brighter than the others outweigh them, many that are alike do not. Particles of finite size
blur as well, by a quarter of their diameter's image, and are taken for the lens.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.lightfield import Layout, LightField
from plenopiv.projection.plenoptic.blurred import sharp_tables
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane, camera_constants, column_of, planes
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.noise import with_neighbours
from plenopiv.sensor import at_full_scale
from plenopiv.volume import VoxelGrid

FARTHEST = 3.2  # pitches: the longest lag
BASELINES = (0.17, 0.5, 1.0, 1.5)  # of the aperture's radius, along each axis of the sensor
APART = 0.6  # half dead zones, at most, between planes in which particles are sought: further apart they look blurred
FEWEST_PLANES = 33
BEYOND = 0.25  # of the volume's depth, that planes are sought in front of it and behind it
SIDE = 128  # places across the autocorrelation's table
MOST = 0.8  # pitches: the largest blur that is sought
TRIED = 17  # standard deviations
PARTS = 4  # of the field, whose scatter gives the error
PAIRS = 60  # of views, for each baseline, at most
PHASES = 8  # pairs of microlenses, for each lag, whose phases the model takes
LEAST, SURE = 0.13, 3.0  # pitches and error bars below which a blur is none: of sharp lenses up to 0.11 is found
USUAL = 0.2  # left of the correlations of a thousand microlenses and more, at most
FEWEST = 200  # microlenses whose rays stay in the volume, and that are evenly lit
CLIPPED = 0.3  # of the microlenses, at most, are left out for saturated pixels: more would be those in focus
NEAR, LIT = 3, 0.6  # microlenses on each side; light is even where their mean is this much of the brightest's (90 %)
ABOUT = 7  # microlenses on each side over which the mean light is taken off: farther than the longest lag
FEWEST_ACROSS, FEWEST_ROWS = 13, 9  # microlenses of a sensor that has some with all lags about them

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LensBlur:
    """Blur of the main lens: ``blur_mm``, standard deviation along each axis on the microlens plane; its error bar
    ``std_mm``; ``left``: what the best fit leaves of the correlations, RMS as a share of theirs."""

    blur_mm: float
    std_mm: float
    left: float

    def least_mm(self, pitch_mm: float) -> float:
        """The smallest blur that could be told from none: it grows where few microlenses leave more unexplained."""
        return max(LEAST * pitch_mm * max(1.0, self.left / USUAL), SURE * self.std_mm)

    def beyond_doubt(self, pitch_mm: float) -> float:
        """The blur, mm; 0 where it may be none."""
        return self.blur_mm if self.blur_mm > self.least_mm(pitch_mm) else 0.0


class Lag(NamedTuple):
    """From one microlens to another: ``across`` rows, and ``along`` them in pitches."""

    along: float
    across: int

    def columns(self, odd: int) -> int:
        """Columns from a microlens in a row that is ``odd`` (shifted by half a pitch; 0 on a square lattice)."""
        return round(self.along - 0.5 * ((self.across + odd) % 2 - odd)) if self.along % 1 else round(self.along)


def lens_blur(lightfield: LightField, projector: PlenopticProjector) -> LensBlur | None:
    """The main lens' blur from the light of one frame, whatever the camera states of it; None where the volume, the
    sensor or what is evenly lit is too small, or the frame too dark, to tell. ``projector``: of the volume."""
    where = lightfield.layout
    if where.ni < FEWEST_ACROSS or where.nj < FEWEST_ROWS:
        return None
    views = projector.whole_views
    inside = np.zeros((where.views, where.nj, where.ni), bool)
    for view in views:
        inside[view] = projector.rays_inside_grid(int(view)).reshape(where.nj, where.ni)
    clipped = with_neighbours(at_full_scale(lightfield.values, where.camera.sensor).any(0).reshape(where.nj, where.ni))
    if np.count_nonzero(clipped & inside.any(0)) < CLIPPED * np.count_nonzero(inside.any(0)):
        inside &= ~clipped
    if inside[views].sum(0).max() == 0 or inside[views].any(0).sum() < FEWEST:
        return None
    values, inside = where_evenly_lit(lightfield.values.reshape(inside.shape), inside)
    if inside[views].any(0).sum() < FEWEST:
        return None
    pairs, lags = pairs_of_views(where, views), lags_of(where.camera)
    parts = parts_of(inside[views].any(0).sum(1))
    summed = np.array([correlations(where, values, inside, pairs, lags, rows) for rows in parts])
    products, counts = summed[:, 0], summed[:, 1]
    if not (counts.sum(0) - counts > 0).all():
        return None
    sigmas = np.linspace(0.0, MOST, TRIED)
    models = model(where, projector.grid, [baseline for baseline, _ in pairs], lags, sigmas)
    whole, left = best(products.sum(0) / counts.sum(0), models, sigmas)
    without = [
        best((products.sum(0) - p) / (counts.sum(0) - c), models, sigmas)[0]
        for p, c in zip(products, counts, strict=True)
    ]
    std = np.sqrt((PARTS - 1) / PARTS * np.sum((np.array(without) - np.mean(without)) ** 2))  # jackknife
    pitch = where.camera.lattice.pitch_mm
    return LensBlur(whole * pitch, float(std) * pitch, left)


def where_evenly_lit(values: NDArray[np.float32], inside: NDArray[np.bool_]) -> tuple[NDArray, NDArray[np.bool_]]:
    """Without the mean light about them ``values`` (view, nj, ni), 0 elsewhere than where they are ``inside`` and about
    as bright as anywhere; and where that is."""
    from scipy.ndimage import uniform_filter

    def mean(one: NDArray, of: NDArray, reach: int) -> Array:
        above, below = (uniform_filter(k.astype(np.float64), 2 * reach + 1, mode="constant") for k in (one, of))
        return np.asarray(above / np.maximum(below, 1e-6))

    count = inside.sum(0)
    light = mean(np.where(inside, values, 0).sum(0), count, NEAR)
    even = inside & (light >= LIT * np.percentile(light[count > 0], 90))
    out = np.zeros(values.shape, np.float32)
    for view, of_view in enumerate(even):
        about = mean(np.where(of_view, values[view], 0), of_view, ABOUT)
        out[view] = np.where(of_view, values[view] - about, 0)
    return out, even


def parts_of(microlenses: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Rows of PARTS of the field that have about as many ``microlenses`` (nj,), the number in each row."""
    part = (np.cumsum(microlenses) - 1) * PARTS // max(int(microlenses.sum()), 1)
    return [np.flatnonzero(part == k) for k in range(PARTS)]


def lags_of(camera: PlenopticCamera) -> list[Lag]:
    """All lags up to FARTHEST."""
    hexagonal, spacing = camera.lattice.kind == "hexagonal", camera.lattice.row_spacing
    out = []
    for across in range(-4, 5):
        shift = 0.5 * (across % 2) if hexagonal else 0.0
        for column in range(-5, 5):
            if np.hypot(column + shift, across * spacing) <= FARTHEST:
                out.append(Lag(column + shift, across))
    return out


def pairs_of_views(where: Layout, views: NDArray[np.int64]) -> list[tuple[tuple[int, int], NDArray[np.int64]]]:
    """For each baseline (m, n), px, the pairs (k, 2) of ``views`` that far apart."""
    number = {tuple(where.offsets[view]): int(view) for view in views}
    radius, out = where.camera.aperture_radius_px, []
    for length in sorted({max(round(share * radius), 1) for share in BASELINES}):
        for m, n in ((length, 0), (0, length)):
            found = [(v, number[k[0] + m, k[1] + n]) for k, v in number.items() if (k[0] + m, k[1] + n) in number]
            if found:
                out.append(((m, n), np.array(found)[:: max(1, -(-len(found) // PAIRS))]))
    return out


def correlations(
    where: Layout,
    values: NDArray[np.float32],
    inside: NDArray[np.bool_],
    pairs: list[tuple[tuple[int, int], NDArray[np.int64]]],
    lags: list[Lag],
    rows: NDArray[np.int64],
) -> Array:
    """Sums of products of ``values`` (view, nj, ni) and their number, (2, baseline, lag), of microlenses of ``rows``
    and those a lag from them."""
    out = np.zeros((2, len(pairs), len(lags)))
    hexagonal = where.camera.lattice.kind == "hexagonal"
    for odd in (0, 1):
        of = rows[(rows + where.j0) % 2 == odd]
        for c, lag in enumerate(lags):
            di = lag.columns(odd if hexagonal else 0)
            here = of[(of + lag.across >= 0) & (of + lag.across < where.nj)]
            first = slice(max(-di, 0), where.ni - max(di, 0))
            second = slice(max(di, 0), where.ni - max(-di, 0))
            for b, (_, both) in enumerate(pairs):
                v, w = both.T
                one, two = values[v][:, here, first], values[w][:, here + lag.across, second]
                out[0, b, c] += np.einsum("vji,vji", one, two)
                out[1, b, c] += np.count_nonzero(inside[v][:, here, first] & inside[w][:, here + lag.across, second])
    return out


def model(where: Layout, grid: VoxelGrid, baselines: list[tuple[int, int]], lags: list[Lag], sigmas: Array) -> Array:
    """What planes of particles correlate, (sigma, baseline * lag, plane), for blurs of ``sigmas`` pitches."""
    from scipy.ndimage import map_coordinates

    camera, (lo, hi) = replace(where.camera, blur_mm=0.0), grid.limits_mm()[2]
    more = BEYOND * (hi - lo)
    hi = min(hi + more, 0.5 * (hi + camera.main_lens.object_distance_mm))
    lo, near, far = lo - more, *camera.dead_zone_mm()
    count = max(FEWEST_PLANES, ceil((hi - lo) / (APART * (far - near))))
    step_mm = (hi - lo) / count
    deep = VoxelGrid((0.0, 0.0, lo + 0.5 * step_mm), (*grid.voxel_mm[:2], step_mm), (count, 1, 1))
    cam, table = camera_constants(camera, deep), planes(camera, deep)
    support = 2 * (0.6 + column_of(table, "half")) + 4 * MOST  # where the autocorrelation ends
    steps = np.repeat((2 * support / SIDE)[:, None], 2, 1).astype(np.float32)
    power = np.abs(np.fft.rfft2(sharp_tables(cam, table, steps, SIDE))) ** 2
    turns = (np.fft.fftfreq(SIDE)[:, None] ** 2 + np.fft.rfftfreq(SIDE) ** 2) * (2 * np.pi) ** 2
    at = np.array([places(where, cam, row, baselines, lags) for row in table])  # (plane, baseline, lag, phase, 2)
    out = np.empty((len(sigmas), at.shape[1] * at.shape[2], count))
    for s, sigma in enumerate(sigmas):
        for k in range(count):
            wide = np.fft.fftshift(np.fft.irfft2(power[k] * np.exp(-turns * (sigma / steps[k, 0]) ** 2)))
            x, y = np.moveaxis(at[k].reshape(-1, PHASES, 2) / steps[k, 0] + SIDE // 2, -1, 0)
            out[s, :, k] = map_coordinates(wide, (y, x), order=1).mean(1)
    return out


def places(
    where: Layout, cam: CameraConstants, row: NDArray[np.float32], baselines: list[tuple[int, int]], lags: list[Lag]
) -> Array:
    """Where the autocorrelation of a plane is read, (baseline, lag, phase, 2), cells along and across the rows."""
    plane, lattice = Plane(*row.tolist()), where.camera.lattice
    hexagonal = lattice.kind == "hexagonal"
    phase = where.phase.reshape(where.nj, where.ni, 2)
    out = np.empty((len(baselines), len(lags), PHASES, 2))
    rng = np.random.default_rng(0)
    for c, lag in enumerate(lags):
        j = rng.integers(4, where.nj - 4, PHASES)
        i = rng.integers(6, where.ni - 6, PHASES)
        odd = (j + where.j0) % 2 if hexagonal else np.zeros(PHASES, int)
        di = np.array([lag.columns(int(o)) for o in odd])
        off = phase[j + lag.across, i + di] - phase[j, i]
        for b, (m, n) in enumerate(baselines):
            x, y = plane.move * (m - off[:, 0]), plane.move * (off[:, 1] - n)
            out[b, c, :, 0] = cam.cos * x + cam.sin * y - lag.along * plane.pitch
            out[b, c, :, 1] = cam.cos * y - cam.sin * x - lag.across * lattice.row_spacing * plane.pitch
    return out


def best(measured: Array, models: Array, sigmas: Array) -> tuple[float, float]:
    """The standard deviation whose planes fit ``measured`` (baseline, lag) best, pitches, and what they leave."""
    from scipy.optimize import nnls

    baselines, lags = measured.shape
    even = np.kron(np.eye(baselines), np.ones((lags, 1)))
    scale = np.abs(models[0]).max()
    left = np.array([
        nnls(np.hstack([one / scale, even, -even]), measured.ravel() / np.abs(measured).max(), maxiter=5000)[1] ** 2
        for one in models
    ])  # fmt: skip
    k = min(max(int(np.argmin(left)), 1), len(sigmas) - 2)
    a, b, c = np.polyfit(sigmas[k - 1 : k + 2] ** 2, left[k - 1 : k + 2], 2)
    square = -b / (2 * a) if a > 0 else sigmas[int(np.argmin(left))] ** 2
    square = float(np.clip(square, 0.0, MOST**2))
    residual = max(np.polyval((a, b, c), square), 0.0)
    return float(np.sqrt(square)), float(np.sqrt(residual / np.sum((measured / np.abs(measured).max()) ** 2)))
