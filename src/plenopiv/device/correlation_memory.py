"""How much of the device's memory a pair's correlation takes, and what of it is held at once.

The factors are those of the compiled programs (``memory_analysis``), rounded up; tests/device compares them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, prod

from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.transforms import fast_length
from plenopiv.displacement.windows import step_of
from plenopiv.errors import PlenoPIVError

Shape = tuple[int, int, int]  # along z, y, x

BATCH_VOXELS = 1 << 24  # of the windows that a graphics processor correlates at once, at most
BATCH_VOXELS_CPU = 1 << 19
LEAST_VOXELS = 1 << 18  # of a batch where memory is short: a few windows
WINDOW = 14.0  # arrays of a batch's voxels, with room for a library's transforms
HELD = 3.0  # planes for each of a layer's: held of both volumes, and a copy while those of one move on
MADE = 2.0  # planes for each that is deformed from one layer to the next: source and result
ONE = 30.0  # planes while one is deformed: its displacements, places and weights
REACH = 16.0  # planes that deformation reads beyond those that it makes, on both sides together; more where w is large


@dataclass(frozen=True)
class Room:
    """What is held on the device: both volumes as a whole (``resident``), or some planes at a time; ``voxels`` of the
    windows of a batch; ``needed`` bytes in all."""

    resident: bool
    voxels: int
    needed: float

    def batch(self, size: Sequence[int], count: int) -> int:
        """Windows of a batch, where there are ``count`` of ``size`` in a layer: batches are filled alike."""
        most = max(1, self.voxels // prod(size))
        return ceil(count / ceil(count / most))


def room(shape: Shape, settings: CorrelationSettings, memory: float | None, *, voxels: int | None = None) -> Room:
    """What is held of a pair of volumes of ``shape`` in so many bytes of ``memory``, None for as many as it takes: the
    volumes as a whole where that fits. ``voxels``: of a batch, by default those that suit the device in use.

    Raises:
        PlenoPIVError: the memory does not suffice for the planes of one layer of windows.
    """
    most = max(voxels or _suited(), max(_around(window) for window, _ in settings.passes))
    least = max(min(most, LEAST_VOXELS), max(_around(window) for window, _ in settings.passes))
    layers = layers_bytes(shape, settings)
    whole = 2 * 4.0 * prod(shape)
    for resident in (True, False):
        for count in _halves(most, least):
            needed = layers + batch_bytes(count) + (whole if resident else 0.0)
            if memory is None or needed <= memory:
                return Room(resident, count, needed)
    assert memory is not None
    raise PlenoPIVError(
        f"compute.device_memory_gb: the correlation takes {needed / 1e9:.2g} GB of the device's memory, more than "
        f'{memory / 1e9:.2g} GB: use windows of fewer planes (correlation.windows), or compute.device = "cpu"'
    )


def batch_bytes(voxels: int) -> float:
    """Bytes of a batch of windows of so many voxels in all."""
    return WINDOW * 4.0 * voxels


def layers_bytes(shape: Shape, settings: CorrelationSettings) -> float:
    """Bytes of the deepest layer of windows, and of what it is made of."""
    nz, ny, nx = shape
    planes = 0.0
    for window, overlap in settings.passes:
        step = step_of(window[2], overlap)
        planes = max(planes, HELD * window[2] + MADE * step + min(REACH, nz))
    return (planes + ONE) * 4.0 * ny * nx


def _halves(most: int, least: int) -> list[int]:
    """``most``, half of it, and so on to ``least``."""
    out = [most]
    while out[-1] // 2 >= least:
        out.append(out[-1] // 2)
    return out


def _around(window: Sequence[int]) -> int:
    return prod(fast_length(n) for n in window)


def _suited() -> int:
    import jax

    return BATCH_VOXELS_CPU if jax.default_backend() == "cpu" else BATCH_VOXELS
