"""From one frame to a volume on the device: ``reconstruction.reconstruct`` with candidates and MART there.

A frame goes to the device once for each tile, and the voxels that hold light come back. What is measured on a frame
before (its noise, its typical particle) is measured on this processor, in some seconds of the largest frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from plenopiv.device.mart import Frame, mart
from plenopiv.device.projection import on_device
from plenopiv.device.volume import DeviceVolume
from plenopiv.projection.protocol import Projection
from plenopiv.reconstruction.candidates import judgement
from plenopiv.reconstruction.mart import Progress
from plenopiv.reconstruction.noise import Noise
from plenopiv.reconstruction.reconstruct import Steps, even_light, thinning
from plenopiv.reconstruction.reconstruct import reconstruct as reconstruct_by_steps
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import Tile
from plenopiv.volume import SparseVolume


class Candidates(NamedTuple):
    """``reconstruction.candidates.Candidates`` on the device."""

    volume: DeviceVolume
    threshold: float
    particle: float


def find(
    values: NDArray[np.float32],
    projection: Projection,
    settings: ReconstructionSettings,
    noises: Sequence[Noise],
    name: str,
) -> Candidates:
    """``find_candidates``, arguments and errors too; PlenoPIVError also for weights that are not exact areas."""
    most, lights, threshold, particle = judgement(values, projection, settings, noises, name)
    device = on_device(projection)
    volume = device.visible_voxels() if most is None else device.candidates(most, lights)
    return Candidates(DeviceVolume(projection.grid, volume), threshold, particle)


def corrected(
    values: NDArray[np.float32],
    projection: Projection,
    volume: DeviceVolume,
    settings: ReconstructionSettings,
    floor: float | NDArray[np.float32],
    saturated: NDArray[np.bool_] | None,
    times: float,
    progress: Progress | None,
) -> tuple[DeviceVolume, list[float]]:
    """MART on the voxels of ``volume``, whose memory it takes, and the residual of each iteration."""
    device, start = on_device(projection), volume.values
    form = device.form
    if (light := even_light(values, settings, times)) is not None:
        start = _alike(start, np.float32(light / volume.listed(0, volume.grid.shape[1])))
    frame = Frame(
        jnp.asarray(form.padded(values)),
        jnp.asarray(form.padded(projection.seen)),
        None if saturated is None else jnp.asarray(form.padded(saturated)),
        jnp.asarray(form.padded(floor) if isinstance(floor, np.ndarray) else floor, jnp.float32),
    )
    found, residuals = mart(
        frame,
        form,
        device.tables,
        start,
        iterations=settings.iterations,
        relaxation=settings.relaxation,
        thin=thinning(settings),
        seed=settings.seed,
        progress=progress,
    )
    return DeviceVolume(volume.grid, found), residuals


def listed(tile: Tile, volume: DeviceVolume) -> int:
    """``Tile.listed``."""
    return volume.listed(tile.first - tile.low, tile.end - tile.low)


def own_rows(tile: Tile, volume: DeviceVolume) -> SparseVolume:
    """``Tile.own_rows``, in this processor's memory."""
    return volume.sparse(tile.first - tile.low, tile.end - tile.low)


@partial(jax.jit, donate_argnums=0)
def _alike(volume: jax.Array, light: jax.Array) -> jax.Array:
    """The same ``light`` in all voxels that are listed."""
    return jnp.where(volume > 0, light, 0.0)


STEPS = Steps(find, listed, corrected, own_rows)
reconstruct = partial(reconstruct_by_steps, steps=STEPS)  # of a frame, arguments and results as there
