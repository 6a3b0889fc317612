"""What a comparison will take, before it starts: memory and time of each of its measurements."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import numba
from comparison_settings import Comparison, LightFieldSetting, TomoSetting, TwoCamerasSetting
from lightfield_case import Setting, camera_of, correlation_of
from two_cameras_case import POSES, cameras_of

from plenopiv.reconstruction.settings import TOMOGRAPHY, ReconstructionSettings
from plenopiv.run import duration, memory

CAMERAS = 4
SIGHT = 2.5e-8  # s, a voxel in one camera's lines of sight, one core
CORRECT = 7.5e-8  # s, a listed voxel projected and corrected, for one camera (decision 22)
LISTED = 0.1  # of the voxels that lines of sight leave at 0.05 particles per pixel
LARGE = 1e9  # bytes of planes looked at at once: of more, the system makes the pages anew again and again
SLOWER = 1.8  # times as long, volumes of such planes
LEFT_BY_BOTH = 0.15  # of the voxels in a deep volume
TURNED_BYTES = 60.0  # a voxel of theirs while it is put in the second camera's order
DENSE_BYTES = 10.0  # a voxel of exact volumes
LISTED_BYTES = 40.0  # a listed voxel while its frame is reconstructed, the frame before it (6) with it


def light_field_cost(setting: LightFieldSetting) -> tuple[float, float]:
    """Bytes and seconds of LF-PIV; simulation left out."""
    camera = camera_of(setting)
    correlation = correlation_of(setting)
    takes = duration.of_settings(camera, setting.grid, ReconstructionSettings(), correlation, numba.get_num_threads())
    seconds = takes.run(2) + _again(setting) / numba.get_num_threads()
    return memory.estimate(camera, setting.grid).peak, seconds


def _pair(setting: Setting) -> float:
    """Seconds of one core for all correlation of a pair of volumes."""
    return duration.correlation_s(setting.grid, correlation_of(setting).passes) + _again(setting)


def _again(setting: Setting) -> float:
    """Seconds of one core for the correlation with sub-window averaging, if there is one."""
    if setting.inner_window is None:
        return 0.0
    return duration.correlation_s(setting.grid, correlation_of(setting, setting.inner_window).passes)


def two_cameras_cost(setting: TwoCamerasSetting) -> tuple[float, float]:
    """The same with two cameras: light fields of both, and the list of what both leave once more, in the second one's
    order."""
    correlation = correlation_of(setting)
    threads = numba.get_num_threads()
    peak, seconds = memory.BASE, 0.0
    for camera, pose in zip(cameras_of(setting), POSES, strict=True):
        grid = pose.grid(setting.grid)
        takes = duration.of_settings(camera, grid, ReconstructionSettings(), correlation, threads)
        peak += memory.estimate(camera, grid).peak - memory.BASE
        seconds += takes.frame
    peak += LEFT_BY_BOTH * setting.grid.size * TURNED_BYTES
    return peak, 2 * seconds + takes.pair + _again(setting) / threads


def tomo_cost(setting: TomoSetting) -> tuple[float, float]:
    """Bytes and seconds of Tomo-PIV; simulation left out."""
    grid = setting.grid
    frame = CAMERAS * grid.size * (SIGHT + LISTED * TOMOGRAPHY.iterations * CORRECT)
    layer = 4.0 * 2 * prod(grid.shape[1:]) * setting.windows[0][2]
    peak = memory.BASE + LISTED_BYTES * LISTED * grid.size + layer
    return peak, (SLOWER if layer > LARGE else 1.0) * (2 * frame + _pair(setting)) / numba.get_num_threads()


def exact_cost(setting: LightFieldSetting) -> tuple[float, float]:
    """Windows by themselves and within windows, of a volume that was dense when it was made."""
    return memory.BASE + DENSE_BYTES * setting.grid.size, _pair(setting) / numba.get_num_threads()


def announced(setting: Comparison, names: Sequence[str]) -> dict[str, str]:
    """Voxels, memory and time of each of these measurements."""
    costs = {
        "light_field": (light_field_cost, setting.light_field),
        "exact": (exact_cost, setting.light_field),
        "two": (two_cameras_cost, setting.two),
        "tomo": (tomo_cost, setting.tomo),
        "matched": (tomo_cost, setting.matched),
    }
    told = {}
    for name in names:
        cost, own = costs[name]
        peak, seconds = cost(own)
        told[name] = (
            f"{' x '.join(map(str, own.grid.shape[::-1]))} voxels, about {peak / 1e9:.1f} GB and "
            f"{duration.as_text(seconds)} on {numba.get_num_threads()} threads"
        )
    return told
