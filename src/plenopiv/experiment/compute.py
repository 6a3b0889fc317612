"""``[compute]``: on which device."""

from __future__ import annotations

from typing import Literal

from plenopiv.experiment.tables import PositiveFloat, Table


class ComputeTable(Table):
    """``[compute]``: keys as ``device.backend.device_of`` takes them.

    ``device``: this processor, a graphics processor, or "auto", that where there is one; "jax-cpu", for tests, runs the
    graphics processor's code on this processor. ``device_memory_gb``: what may be taken of the device's memory.
    """

    device: Literal["cpu", "gpu", "auto", "jax-cpu"] = "cpu"
    device_memory_gb: PositiveFloat | None = None
