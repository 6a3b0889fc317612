"""Whether the microlens array has moved since the white image was taken."""

from __future__ import annotations

from plenopiv.calibration.drift import DriftFit
from plenopiv.checks.findings import Finding
from plenopiv.sensor import Sensor

NAME = "drift"


def finding(found: DriftFit, sensor: Sensor) -> Finding | None:
    """The finding on a drift, which a run takes into account; None where nothing moved."""
    moved = found.drift
    if not moved:
        return None
    right, down = moved.shift_px
    words = f"the microlenses have moved since the white image: {right:+.2f} px to the right, {down:+.2f} px down"
    words += f", {moved.turn_deg:+.3f} degrees counter-clockwise" if moved.turn_deg else ""
    words += f", {100 * moved.scale:+.3f} % further apart" if moved.scale else ""
    return Finding(NAME, "good", f"{words}, which a run takes into account", moved.most_px(sensor), "px")
