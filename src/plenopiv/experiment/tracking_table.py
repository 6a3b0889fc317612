"""The table [tracking] of an experiment file."""

from __future__ import annotations

from plenopiv.experiment.tables import PositiveFloat, Table


class TrackingTable(Table):
    """``[tracking]``: particles and their links, for ``plenopiv track``.

    ``max_displacement_mm``: of a particle between two frames; where absent three times what correlation finds at most.
    ``wavelength_nm``: of the light, whose diffraction blurs micro-images.
    """

    max_displacement_mm: PositiveFloat | None = None
    wavelength_nm: PositiveFloat = 532.0
