"""The multi-grid loop: correlate, validate, deform, with ever smaller windows."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numba
import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.agreement import agreement
from plenopiv.displacement.deformation import SPLINE_VARIANCE, DeformedPlanes
from plenopiv.displacement.field import DisplacementField
from plenopiv.displacement.offset import discrete_offset
from plenopiv.displacement.peaks import find_peaks
from plenopiv.displacement.predictor import SplineField, fit_spline, smooth_predictor
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.solid import Solid
from plenopiv.displacement.sub_windows import average_sub_windows
from plenopiv.displacement.uncertainty import ScatterCorrelator, standard_deviation
from plenopiv.displacement.validation import find_outliers, replace_invalid
from plenopiv.displacement.windows import WindowBatch, WindowGrid, window_grid
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.volume import Volume

_BATCH_VOXELS = 1 << 18  # windows of a batch and their spectra stay in a core's cache

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class PassResult:
    """What one pass measured: ``displacement`` (3, nz, ny, nx) voxels, ``found`` and ``peak_ratio`` (nz, ny, nx).

    ``variance`` (3, nz, ny, nx), voxel^2: scatter of the particles of a window about its peak; None unless ``scatter``.
    """

    displacement: NDArray[np.float64]
    found: NDArray[np.bool_]
    peak_ratio: NDArray[np.float32]
    variance: NDArray[np.float64] | None = None


def correlation_pass(
    a: Volume,
    b: Volume,
    windows: WindowGrid,
    predictor: SplineField | None,
    settings: CorrelationSettings,
    search: float,
    step_done: Callable[[int, int], None] | None = None,
    scatter: bool = False,
) -> PassResult:
    """Correlate all windows of two volumes once.

    ``predictor``: displacement by which the volumes are deformed first; the result is its value at the window centres
    plus what the correlation finds. None: volumes as they are. ``settings``: smoothing, taper, whitening and
    agreement. ``search``: largest displacement to find, as a fraction of the window. ``scatter``: whether to estimate
    the variance as well, at about twice the cost. One layer of windows, and what the next one adds to it, is in memory
    at a time; results do not depend on the number of threads (Numba's, ``NUMBA_NUM_THREADS``).
    """
    size = windows.size
    radius = tuple(max(1, min(round(search * n), n // 2 - 2)) for n in size)
    done = 0.0 if predictor is None else SPLINE_VARIANCE
    variance = max(settings.smoothing_voxels**2 - done, 0.0)
    correlator = ScatterCorrelator(size, radius, variance, settings.whitening, settings.taper_voxels)  # type: ignore[arg-type]
    nz, ny, nx = windows.shape
    found = np.zeros((nz, ny * nx), bool)
    ratio = np.zeros((nz, ny * nx), np.float32)
    moved = np.zeros((nz, ny * nx, 3))
    spread = np.zeros_like(moved)
    corners = np.array(list(product(windows.starts[1].tolist(), windows.starts[2].tolist())))
    batch = max(1, _BATCH_VOXELS // int(np.prod(size)))
    power = settings.agreement
    cuts = None if predictor is None else window_cuts(windows, predictor, a.grid.shape).reshape(nz, ny * nx, 3, 2)
    sources = (a, b) if predictor is None else (DeformedPlanes(a, predictor, -0.5), DeformedPlanes(b, predictor, 0.5))

    with ThreadPoolExecutor(numba.get_num_threads()) as pool, ThreadPoolExecutor(1) as ahead:
        layers = zip(*(_layers(source, windows, ahead) for source in sources), strict=True)
        for layer, (planes_a, planes_b) in enumerate(layers):

            def work(lo: int, layer: int = layer, pa: NDArray = planes_a, pb: NDArray = planes_b) -> None:
                part = slice(lo, min(lo + batch, len(corners)))
                first, second = (WindowBatch.cut(planes, corners[part]) for planes in (pa, pb))
                if cuts is None:
                    spectra = correlator.spectra(first, second)
                else:
                    weights = None
                    if power:
                        held = ([p[:, j : j + size[1], i : i + size[2]] for j, i in corners[part]] for p in (pa, pb))
                        weights = agreement(*map(np.stack, held)) ** np.float32(power)
                    spectra = correlator.spectra(first, second, cuts[layer, part], weights)
                correlation = correlator.correlation(spectra)
                place, untilt = np.empty((len(spectra.lit), 3), np.int64), np.empty((len(spectra.lit), 3, 3))
                into = moved[layer, part], ratio[layer, part], found[layer, part]
                find_peaks(correlation, spectra.gain, *into, place, untilt)
                found[layer, part] &= spectra.lit
                moved[layer, part][~spectra.lit] = 0.0
                if scatter:
                    spread[layer, part] = correlator.variance(spectra, place, untilt)
                ratio[layer, part][~spectra.lit] = 0.0

            list(pool.map(work, range(0, len(corners), batch)))
            if step_done is not None:
                step_done(layer + 1, nz)
    displacement, scattered = (np.moveaxis(v.reshape(nz, ny, nx, 3), -1, 0) for v in (moved, spread))
    if predictor is not None:
        displacement = displacement + predictor.at(*windows.centres)
    shape = (nz, ny, nx)
    return PassResult(displacement, found.reshape(shape), ratio.reshape(shape), scattered if scatter else None)


def first_pass(
    a: Volume,
    b: Volume,
    windows: WindowGrid,
    settings: CorrelationSettings,
    step_done: Callable[[int, int], None] | None = None,
    scatter: bool = False,
    closed: NDArray[np.bool_] | None = None,
) -> PassResult:
    """Correlate all windows of two volumes as they are, validate, and measure each vector again by discrete window
    offset (``discrete_offset``).

    Arguments as for ``correlation_pass``, ``closed`` for ``_validated``; peak ratio and variance are those before the
    offset.
    """
    result = correlation_pass(a, b, windows, None, settings, settings.search, step_done, scatter)
    valid, displacement = _validated(result, settings, closed)
    again, found = discrete_offset(a, b, windows, displacement)
    # what is not found again stays as the transforms had it; a vector that was not valid has no second peak
    displacement = np.where(found | valid, again, result.displacement)
    ratio = np.where(found & ~valid, np.float32(0.0), result.peak_ratio)
    return replace(result, displacement=displacement, found=valid | found, peak_ratio=ratio)


def window_cuts(windows: WindowGrid, predictor: SplineField, shape: tuple[int, int, int]) -> NDArray[np.float64]:
    """Voxels (nz, ny, nx, 3, 2) that windows lose at their low and high ends along z, y, x.

    Samples at x -+ d/2 both come from a volume of ``shape`` where x stays |d|/2 away from its faces. d is taken where
    the window ends, the largest of nine points; at most a quarter of a window is cut.
    """
    places = []
    for start, n in zip(windows.starts, windows.size, strict=True):
        places.append((start[:, None] + np.array([0, n // 2, n - 1])).ravel())
    nz, ny, nx = windows.shape
    half = np.abs(predictor.at(*places)).reshape(3, nz, 3, ny, 3, nx, 3).transpose(0, 1, 3, 5, 2, 4, 6) / 2
    out = np.zeros((nz, ny, nx, 3, 2))
    for axis, (start, n, total) in enumerate(zip(windows.starts, windows.size, shape, strict=True)):
        ends = np.moveaxis(half[2 - axis], 3 + axis, 0)
        for side, (end, gap) in enumerate(((ends[0], start), (ends[2], total - n - start))):
            gap = gap.reshape([-1 if k == axis else 1 for k in range(3)])
            out[..., axis, side] = np.clip(end.max((-2, -1)) - gap, 0.0, n / 4)
    return out


def compressed(volume: Volume, exponent: float) -> Volume:
    """The volume with its intensities raised to a power, other than 1 with negative ones as none."""
    if exponent == 1.0:
        return volume
    values = np.maximum(volume.values, np.float32(0.0))
    return volume.with_values(np.sqrt(values) if exponent == 0.5 else values ** np.float32(exponent))


def _layers(
    source: Volume | DeformedPlanes, windows: WindowGrid, ahead: ThreadPoolExecutor
) -> Iterator[NDArray[np.float32]]:
    """The planes of each layer of windows in turn. Planes that two layers share are made once; ``ahead``, which has one
    thread, makes the other planes of the next layer while one is correlated."""
    depth, step = windows.size[0], windows.step[0]
    starts = windows.starts[0].tolist()
    first, kept = source.slab(starts[0], starts[0] + min(step, depth)), max(depth - step, 0)
    planes = np.empty((depth, *first.shape[1:]), np.float32)
    planes[: len(first)] = first
    del first
    for made in range(step, depth, step):
        planes[made : made + step] = source.slab(starts[0] + made, starts[0] + min(made + step, depth))
    for start in starts[1:]:
        coming = ahead.submit(source.slab, start + kept, start + depth)
        yield planes
        planes[:kept] = planes[depth - kept :].copy()
        planes[kept:] = coming.result()
    yield planes


def measure(
    a: Volume,
    b: Volume,
    settings: CorrelationSettings,
    progress: Progress | None = None,
    solid: Solid | None = None,
) -> DisplacementField:
    """Displacement field from volume ``a`` to volume ``b``, in voxels.

    Passes run from the coarsest windows to the finest (Scarano & Riethmuller 2000; in 3D Elsinga et al. 2006); vectors
    are validated after each, and those of the first measured again by discrete window offset.
    ``progress``: called as (what, done, total). ``solid``: vectors in it are not measured, and no other depends on what
    the volumes hold in such windows. Warns when particles move more than a quarter of the first window;
    raises ``PlenoPIVError`` when the volumes differ in grid, windows do not fit, or nothing is found.
    """
    if a.grid != b.grid:
        raise PlenoPIVError(
            f"correlation: the volumes differ in grid: {a.grid} and {b.grid}; reconstruct both on the same one"
        )
    shape = a.grid.shape
    passes = settings.passes
    plan = [window_grid(shape, *each) for each in passes]
    a, b = (compressed(volume, settings.intensity_exponent) for volume in (a, b))
    predictor: SplineField | None = None
    for number, windows in enumerate(plan, 1):
        report = None if progress is None else partial(progress, f"correlation pass {number} of {len(plan)}")
        closed = None if solid is None else solid.filled(windows, settings.windows[-1])
        scatter = number == len(plan)
        if predictor is None:
            result = first_pass(a, b, windows, settings, report, scatter, closed)
        else:
            search = settings.residual_search if number > len(plan) - settings.fine_passes else settings.search
            result = correlation_pass(a, b, windows, predictor, settings, search, report, scatter)
        valid, displacement = _validated(result, settings, closed)
        if number < len(plan):
            smooth = displacement
            if settings.filter_predictor:
                smooth = smooth_predictor(displacement, passes[number - 1].overlap)
            predictor = fit_spline(smooth, windows.centres, shape)
    _warn_if_far(displacement, valid, settings)
    assert result.variance is not None
    whole = None if settings.sub_window is None else window_grid(shape, settings.windows[-1], settings.overlap)
    std = standard_deviation(displacement, valid, result.variance, plan[-1], settings, whole)
    found = displacement, result.displacement, valid, result.peak_ratio
    if whole is not None:
        found = average_sub_windows(*found, plan[-1], whole)
    z, y, x = (whole or plan[-1]).centres
    field = DisplacementField(z, y, x, *found, std)
    return field if solid is None else field.without(solid.filled(whole or plan[-1], settings.windows[-1]))


def _validated(
    result: PassResult, settings: CorrelationSettings, closed: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which vectors are valid, and the displacement with the others replaced. ``closed`` windows (nz, ny, nx), in a
    solid body, count as if they held no light."""
    threshold, floor = settings.outlier_threshold, settings.outlier_floor_voxels
    measured = result.found if closed is None else result.found & ~closed
    valid = measured & ~find_outliers(result.displacement, measured, threshold, floor)
    return valid, replace_invalid(result.displacement, valid)


def _warn_if_far(displacement: NDArray, valid: NDArray, settings: CorrelationSettings) -> None:
    """Warn of displacements above a quarter of the first window (Keane & Adrian 1992): peaks may then be wrong."""
    for component, name, n in zip(displacement, "xyz", settings.windows[0], strict=True):
        largest = float(np.abs(component[valid]).max())
        if largest > n / 4:
            warnings.warn(
                f"correlation.windows: displacement along {name} reaches {largest:.1f} voxels, more than a quarter of"
                f" the first window ({n}); start with a window of at least {4 * largest:.0f}",
                PlenoPIVWarning,
                stacklevel=3,
            )
