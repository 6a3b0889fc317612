"""The table [tracking] of an experiment file."""

from __future__ import annotations

from math import prod
from typing import Annotated, Literal

from pydantic import Field

from plenopiv.experiment.tables import PositiveFloat, Table
from plenopiv.volume import Limits

MOST_VECTORS = 2e7  # of a field of tracks: some 200 bytes each while it is made


class TrackingTable(Table):
    """``[tracking]``: particles, their links and the field of these, for ``plenopiv track``.

    ``method``: "two-frame", links between the frames of each pair; "multi-frame", tracks over all frames of a sequence,
    the particles of later frames predicted by them. ``max_displacement_mm``: of a particle between two
    frames; where absent three times what correlation finds at most. ``wavelength_nm``: of the light, whose diffraction
    blurs micro-images. ``divergence_free``: of the field. ``grid_mm``: between its vectors; where absent half the last
    window's shortest side.
    """

    method: Literal["two-frame", "multi-frame"] = "two-frame"
    max_displacement_mm: PositiveFloat | None = None
    wavelength_nm: Annotated[float, Field(ge=100.0, le=2000.0)] = 532.0
    divergence_free: bool = True
    grid_mm: PositiveFloat | None = None

    def contradiction(self, limits_mm: Limits) -> str | None:
        """What a volume of these limits makes of ``grid_mm``, where that is no field to be made."""
        step = self.grid_mm
        if step is None or (vectors := prod(max((hi - lo) / step, 1.0) for lo, hi in limits_mm)) <= MOST_VECTORS:
            return None
        return f"tracking.grid_mm: {vectors:.2g} vectors are too many, {MOST_VECTORS:.0g} are the most; is it in mm?"
