"""The multi-grid loop: correlate, validate, deform, with ever smaller windows."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.compression import compressed
from plenopiv.displacement.correlation import Spectra
from plenopiv.displacement.depth_response import depth_response
from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.field import DisplacementField
from plenopiv.displacement.offset import discrete_offset
from plenopiv.displacement.pairs import Pairs, Progress
from plenopiv.displacement.predictor import SplineField, fit_spline, smooth_predictor
from plenopiv.displacement.resolution import averaged_share
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.solid import Solid
from plenopiv.displacement.sub_windows import average_sub_windows
from plenopiv.displacement.uncertainty import part_left_out, standard_deviation
from plenopiv.displacement.validation import accepted, replace_invalid
from plenopiv.displacement.window_pass import PassResult, PassVectors, StepDone, WindowPass
from plenopiv.displacement.windows import WindowGrid, window_grid
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.volume import Volume


@dataclass(frozen=True)
class OnePair:
    """Two volumes, and what their light counts by its depth."""

    a: Volume
    b: Volume
    depth: DepthWeights | None = None

    def correlated(
        self,
        windows: WindowGrid,
        predictor: SplineField | None,
        settings: CorrelationSettings,
        search: float,
        step_done: StepDone | None = None,
        scatter: bool = False,
    ) -> PassResult:
        """See ``correlation_pass``."""
        about = windows, predictor, settings, search, step_done, scatter, self.depth
        return correlation_pass(self.a, self.b, *about)

    def offset(
        self, windows: WindowGrid, first: NDArray[np.float64], progress: Progress | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """See ``discrete_offset``."""
        return discrete_offset(self.a, self.b, windows, first, self.depth)


def correlation_pass(
    a: Volume,
    b: Volume,
    windows: WindowGrid,
    predictor: SplineField | None,
    settings: CorrelationSettings,
    search: float,
    step_done: StepDone | None = None,
    scatter: bool = False,
    depth: DepthWeights | None = None,
) -> PassResult:
    """Correlate all windows of two volumes once.

    ``predictor``: displacement by which the volumes are deformed first; the result is its value at the window centres
    plus what the correlation finds. None: volumes as they are. ``settings``: smoothing, taper, whitening and
    agreement. ``search``: largest displacement to find, as a fraction of the window. ``scatter``: whether to estimate
    the variance as well, at about one and a half times the cost. ``depth``: what light counts by its depth.
    One layer of windows, and what the next one adds to it, is in memory
    at a time; results do not depend on the number of threads (Numba's, ``NUMBA_NUM_THREADS``).
    """
    batches = WindowPass(windows, predictor, settings, search, a.grid.shape, depth)
    vectors, left_out = PassVectors(windows, scatter, settings), part_left_out(settings)

    def work(layer: int, part: slice, spectra: Spectra) -> None:
        correlation = batches.correlator.correlation(spectra)
        powers = batches.correlator.powers
        place, untilt, power = vectors.fit(layer, part, correlation, spectra.gain, spectra.lit, powers)
        if vectors.scattered[layer]:
            vectors.variance[layer, part] = batches.correlator.variance(spectra, place, untilt, power, left_out)

    batches.each_batch(a, b, work, step_done=step_done)
    return vectors.result(predictor)


def first_pass(
    pairs: Pairs,
    windows: WindowGrid,
    settings: CorrelationSettings,
    progress: Progress | None = None,
    step_done: StepDone | None = None,
    scatter: bool = False,
    closed: NDArray[np.bool_] | None = None,
) -> PassResult:
    """Correlate all windows as they are, validate, and measure each vector again by discrete window offset
    (``discrete_offset``).

    Arguments as for ``correlation_pass``, ``closed`` for ``_validated``; peak ratio and variance are those before the
    offset.
    """
    result = pairs.correlated(windows, None, settings, settings.search, step_done, scatter)
    valid, displacement = _validated(result, settings, closed)
    again, found = pairs.offset(windows, displacement, progress)
    # what is not found again stays as the transforms had it; a vector that was not valid has no second peak
    displacement = np.where(found | valid, again, result.displacement)
    ratio = np.where(found & ~valid, np.float32(0.0), result.peak_ratio)
    return replace(result, displacement=displacement, found=valid | found, peak_ratio=ratio)


def measure(
    a: Volume,
    b: Volume,
    settings: CorrelationSettings,
    progress: Progress | None = None,
    solid: Solid | None = None,
    pairs: Callable[[Volume, Volume, DepthWeights | None], Pairs] = OnePair,
    depth: DepthWeights | None = None,
) -> DisplacementField:
    """Displacement field from volume ``a`` to volume ``b``, in voxels.

    Passes run from the coarsest windows to the finest (Scarano & Riethmuller 2000; in 3D Elsinga et al. 2006); vectors
    are validated after each, and those of the first measured again by discrete window offset.
    ``progress``: called as (what, done, total). ``solid``: vectors in it are not measured, and no other depends on what
    the volumes hold in such windows. ``pairs``: what correlates them, by default this processor. ``depth``: what light
    counts by its depth, None where all counts alike.
    Warns when particles move more than a quarter of the first window;
    raises ``PlenoPIVError`` when the volumes differ in grid, windows do not fit, or nothing is found.
    """
    if a.grid != b.grid:
        raise PlenoPIVError(
            f"correlation: the volumes differ in grid: {a.grid} and {b.grid}; reconstruct both on the same one"
        )
    a, b = (compressed(volume, settings.intensity_exponent) for volume in (a, b))
    return multi_grid(pairs(a, b, depth), a.grid.shape, settings, progress, solid)


def multi_grid(
    pairs: Pairs,
    shape: tuple[int, int, int],
    settings: CorrelationSettings,
    progress: Progress | None = None,
    solid: Solid | None = None,
) -> DisplacementField:
    """The passes of ``measure`` over ``pairs`` of volumes of ``shape`` voxels, their intensities compressed."""
    passes = settings.passes
    plan = [window_grid(shape, *each) for each in passes]
    predictor: SplineField | None = None
    for number, windows in enumerate(plan, 1):
        report = None if progress is None else partial(progress, f"correlation pass {number} of {len(plan)}")
        closed = None if solid is None else solid.filled(windows, settings.windows[-1])
        scatter = number == len(plan)
        if predictor is None:
            result = first_pass(pairs, windows, settings, progress, report, scatter, closed)
        else:
            search = settings.residual_search if number > len(plan) - settings.fine_passes else settings.search
            result = pairs.correlated(windows, predictor, settings, search, report, scatter)
        valid, displacement = _validated(result, settings, closed)
        if number < len(plan):
            smooth = displacement
            if settings.filter_predictor:
                smooth = smooth_predictor(displacement, passes[number - 1].overlap)
            predictor = fit_spline(smooth, windows.centres, shape)
    _warn_if_far(displacement, valid, settings)
    assert result.variance is not None
    whole = None if settings.sub_window is None else window_grid(shape, settings.windows[-1], settings.overlap)
    response = None if predictor is None else depth_response(pairs, plan[-1], predictor, settings, result, closed)
    scatter_of = result.variance, plan[-1], settings, whole, response, result.between_pairs
    std = standard_deviation(displacement, valid, *scatter_of)
    found = displacement, result.displacement, valid, result.peak_ratio
    if whole is not None:
        found = average_sub_windows(*found, plan[-1], whole, averaged_share(settings))
    z, y, x = (whole or plan[-1]).centres
    field = DisplacementField(z, y, x, *found, std)
    return field if solid is None else field.without(solid.filled(whole or plan[-1], settings.windows[-1]))


def _validated(
    result: PassResult, settings: CorrelationSettings, closed: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which vectors are valid, and the displacement with the others replaced: by the median of those measured, if none
    is valid, as of frames that do not belong together. ``closed`` windows (nz, ny, nx), in a solid body, count as if
    they held no light."""
    measured = result.found if closed is None else result.found & ~closed
    valid = accepted(result.displacement, result.found, settings, closed)
    if measured.any() and not valid.any():
        middle = np.median(result.displacement[:, measured], axis=1)
        return valid, np.broadcast_to(middle[:, None, None, None], result.displacement.shape).copy()
    return valid, replace_invalid(result.displacement, valid)


def _warn_if_far(displacement: NDArray, valid: NDArray, settings: CorrelationSettings) -> None:
    """Warn of displacements above a quarter of the first window (Keane & Adrian 1992): peaks may then be wrong."""
    for component, name, n in zip(displacement, "xyz", settings.windows[0], strict=True):
        largest = float(np.abs(component[valid]).max(initial=0.0))
        if largest > n / 4:
            warnings.warn(
                f"correlation.windows: displacement along {name} reaches {largest:.1f} voxels, more than a quarter of"
                f" the first window ({n}); start with a window of at least {4 * largest:.0f}",
                PlenoPIVWarning,
                stacklevel=4,
            )
