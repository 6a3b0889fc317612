"""The table [tracking] of an experiment file."""

from __future__ import annotations

from typing import Literal

from plenopiv.experiment.tables import PositiveFloat, Table


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
    wavelength_nm: PositiveFloat = 532.0
    divergence_free: bool = True
    grid_mm: PositiveFloat | None = None
