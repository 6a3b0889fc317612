"""Spatial resolution: by how much vectors take waves in the flow too small, and over which part of a window
sub-window vectors are averaged so that the result resolves what the window's mean does.

A wave exp(i k x) along one axis. A pass measures, under its tapered window (transfer function W), the displacement that
the deformation by the predictor p leaves, and adds p at the window's centre. With F the filter between passes and H the
transfer function of the cubic spline through the vectors, the amplitude after a pass is

    S' = F H S (1 - W) + W,   S = W after the first pass

(Schrijer & Scarano 2008, Exp. Fluids 45, 927, treat the same loop). A mean over a box of side L keeps
sinc(L/wavelength) of it. ``effective_window`` is the box that keeps as much as the vectors do of a wave of two windows.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from plenopiv.displacement.overlap import mean_of_wave
from plenopiv.displacement.predictor import filter_response, spline_aliases
from plenopiv.displacement.settings import CorrelationSettings, Pass, Sides
from plenopiv.displacement.sub_windows import offsets
from plenopiv.displacement.windows import step_of

WAVELENGTH = 2.0  # windows, at which resolution is compared
# Of the model's amplitude this much is measured along x, y, z where a window holds 20 particles: it cuts some at its
# ends, more where they are long.
MEASURED = 0.97, 0.97, 0.945
LEAST_SHARE = 0.25  # of a window, over which sub-window vectors are averaged at least
_ALIASES = 4
_PLACES = 16  # of sub-windows against the window's middle, over which responses are averaged


def response(settings: CorrelationSettings, axis: int, wavelength_voxels: float) -> float:
    """Amplitude of the vectors over that of a wave in the flow along an axis (0 = x, 1 = y, 2 = z)."""
    one = _of_passes(settings, axis, wavelength_voxels)
    if settings.sub_window is None:
        return one
    return one * _of_mean(settings, axis, wavelength_voxels, averaged_share(settings)[axis])


@lru_cache(maxsize=64)
def averaged_share(settings: CorrelationSettings) -> Sides:
    """The share of the last window along x, y, z over which sub-window vectors are averaged.

    The mean over sub-windows is already one over the sub-windows' own extent. Averaged over the whole window as well,
    vectors would resolve what windows a tenth larger do. The share is the one with which they take a wave of two
    windows like the mean over the last window, at least ``LEAST_SHARE``; 1 without sub-windows.
    """
    if settings.sub_window is None:
        return 1.0, 1.0, 1.0
    x, y, z = (_share(settings, axis) for axis in range(3))
    return x, y, z


@lru_cache(maxsize=64)
def effective_window(settings: CorrelationSettings) -> Sides:
    """Sides along x, y, z in voxels of the box whose mean takes a wave of two windows as the vectors do."""
    x, y, z = (_box(settings, axis) for axis in range(3))
    return x, y, z


def _box(settings: CorrelationSettings, axis: int) -> float:
    wavelength = WAVELENGTH * settings.windows[-1][axis]
    kept = float(np.clip(MEASURED[axis] * response(settings, axis, wavelength), 0.0, 1.0))
    return wavelength * float(brentq(lambda side: np.sinc(side) - kept, 0.0, 1.0))


def _share(settings: CorrelationSettings, axis: int) -> float:
    wavelength = WAVELENGTH * settings.windows[-1][axis]
    wanted = float(np.sinc(1 / WAVELENGTH)) / MEASURED[axis]
    one = _of_passes(settings, axis, wavelength)

    def too_much(share: float) -> float:
        return one * _of_mean(settings, axis, wavelength, share) - wanted

    if too_much(1.0) >= 0:
        return 1.0
    return LEAST_SHARE if too_much(LEAST_SHARE) <= 0 else float(brentq(too_much, LEAST_SHARE, 1.0, xtol=1e-4))


def _of_passes(settings: CorrelationSettings, axis: int, wavelength: float) -> float:
    """Amplitude S of the vectors of the last pass."""
    wave, amplitude, before = 2 * np.pi / wavelength, 0.0, None
    for one in settings.passes:
        seen = float(mean_of_wave(one.window[axis], settings.taper_voxels, np.array(wave)))
        predicted = 0.0 if before is None else amplitude * _predicted(before, axis, wave, settings.filter_predictor)
        amplitude, before = predicted * (1 - seen) + seen, one
    return amplitude


def _predicted(before: Pass, axis: int, wave: float, filtered: bool) -> float:
    """F H: what the filter (``predictor.smooth_predictor``) and the spline through the vectors of a pass leave."""
    turn = wave * step_of(before.window[axis], before.overlap)
    left = filter_response(turn, before.overlap) if filtered else 1.0
    return float(left * spline_aliases(turn, _ALIASES)[1][_ALIASES])


def _of_mean(settings: CorrelationSettings, axis: int, wavelength: float, share: float) -> float:
    """Mean over ``share`` of the last window of a wave that is linear between the centres of sub-windows, averaged over
    where these lie."""
    assert settings.sub_window is not None
    size = settings.windows[-1][axis]
    step = step_of(settings.sub_window[axis], settings.inner_overlap)
    off = np.arange(_PLACES)[:, None] / _PLACES
    place = offsets(size, share) / step + off
    below = np.floor(place)
    turn = 2 * np.pi * step / wavelength
    low, high = np.cos(turn * (below - off)), np.cos(turn * (below + 1 - off))
    return float(np.mean(low + (place - below) * (high - low)))
