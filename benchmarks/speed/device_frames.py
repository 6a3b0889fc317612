"""Stages of a frame's reconstruction on a device, measured; for device.py.

The paper's PMR 14 camera before volumes of three or four sizes. One group of views, as MART takes them, forward and
back, of as many listed voxels as are counted, and all of dense ray tracing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

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
    "jax-cpu": ((140, 104, 60), (180, 136, 80), (230, 176, 104), (280, 216, 128)),  # voxels along x, y, z
    "gpu": ((400, 300, 100), (800, 600, 160), (1600, 1200, 240)),
}
SETTINGS = ReconstructionSettings()


ROUNDS = 2  # over all sizes, so that a machine that slows for a while slows all of them


class Stages(Protocol):
    """What is measured of one size."""

    def measure(self) -> None:
        """Once more."""

    def described(self) -> dict[str, Any]:
        """The best of all."""


def in_rounds(prepared: Sequence[Stages]) -> list[dict[str, Any]]:
    """Measure all sizes, the best of all rounds."""
    for _ in range(ROUNDS):
        for each in prepared:
            each.measure()
    return [each.described() for each in prepared]


class Frame:
    """The stages of a frame of a volume of ``size``, ready to be measured."""

    def __init__(self, size: tuple[int, int, int]) -> None:
        scene = Scene(size, (LATERAL_MM, LATERAL_MM, DEPTH_MM))
        projector = self.projector = scene.projector
        device, values = on_device(projector), scene.lightfield.values
        (_, together), *_ = exponents(SETTINGS.iterations, SETTINGS.relaxation, projector.views)[-1:]
        views = np.random.default_rng(0).permutation(projector.views)[:together].astype(np.int32)
        some = np.random.default_rng(1).random(projector.grid.shape) < LISTED
        volume = jnp.asarray(np.where(some, np.float32(0.1), np.float32(0)))
        images = jnp.asarray(device.form.padded(values[views], views))
        listed, dark = device.form.listed(volume), jnp.zeros(projector.grid.shape, jnp.float32)
        noise = noise_of(values, projector.seen, 0.5, None)
        most, lights, _, _ = judgement(values, projector, SETTINGS, [noise], "frame")
        self.stages: dict[str, tuple[Callable[[], Any], int]] = {
            "images": (lambda: _forward(device.form, device.tables, views, volume), 12),
            "back": (lambda: _back(device.form, device.tables, views, images, dark + 0.0, listed), 12),
            "candidates": (lambda: device.candidates(most, lights), 2),
        }
        self.seconds = dict.fromkeys(self.stages, float("inf"))

    def measure(self) -> None:
        """Each stage once more."""
        for name, (stage, times) in self.stages.items():
            self.seconds[name] = min(self.seconds[name], best(stage, times=times))

    def described(self) -> dict[str, Any]:
        """The best seconds of each stage, beside its work."""
        counted = one_group(frame_work(self.projector, SETTINGS))
        stages = {name: {"seconds": self.seconds[name], **vars(stage)} for name, stage in counted.items()}
        return {"shape": list(self.projector.grid.shape), "views": self.projector.views, "stages": stages}
