"""Stages of a frame's reconstruction on a device, measured; for device.py.

The paper's PMR 14 camera before volumes of three sizes. One group of views, as MART takes them, forward and back, of as
many listed voxels as are counted, and all of dense ray tracing.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from scene import DEPTH_MM, LATERAL_MM, Scene

from plenopiv.device.mart import exponents
from plenopiv.device.plan import frame_work, one_group
from plenopiv.device.projection import _back, _forward, on_device
from plenopiv.device.rates import best
from plenopiv.device.work_of_frames import LISTED
from plenopiv.reconstruction.candidates import judgement
from plenopiv.reconstruction.noise import noise_of
from plenopiv.reconstruction.settings import ReconstructionSettings

SIZES = {
    "jax-cpu": ((140, 104, 60), (180, 136, 80), (230, 176, 104)),  # voxels along x, y, z
    "gpu": ((400, 300, 100), (800, 600, 160), (1600, 1200, 240)),
}
SETTINGS = ReconstructionSettings()


def frame(size: tuple[int, int, int]) -> dict[str, Any]:
    """Measure each stage of a frame of a volume of ``size``."""
    scene = Scene(size, (LATERAL_MM, LATERAL_MM, DEPTH_MM))
    projector = scene.projector
    device, values = on_device(projector), scene.lightfield.values
    (_, together), *_ = exponents(SETTINGS.iterations, SETTINGS.relaxation, projector.views)[-1:]
    views = np.random.default_rng(0).permutation(projector.views)[:together].astype(np.int32)
    some = np.random.default_rng(1).random(projector.grid.shape) < LISTED
    volume = jnp.asarray(np.where(some, np.float32(0.1), np.float32(0)))
    images = jnp.asarray(device.form.padded(values[views], views))
    listed, dark = device.form.listed(volume), jnp.zeros(projector.grid.shape, jnp.float32)

    def back() -> Any:
        return _back(device.form, device.tables, views, images, dark + 0.0, listed)

    noise = noise_of(values, projector.seen, 0.5, None)
    most, lights, _, _ = judgement(values, projector, SETTINGS, [noise], "frame")
    seconds = {
        "images": best(_forward, device.form, device.tables, views, volume, times=12),
        "back": best(back, times=12),
        "candidates": best(lambda: device.candidates(most, lights), times=4),
    }
    counted = one_group(frame_work(projector, SETTINGS))
    stages = {name: {"seconds": seconds[name], **vars(stage)} for name, stage in counted.items()}
    return {"shape": list(projector.grid.shape), "views": projector.views, "stages": stages}
