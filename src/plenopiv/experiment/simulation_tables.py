"""The table [simulation] of an experiment file and those below it: what ``plenopiv simulate`` makes of a camera."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from plenopiv.experiment.tables import NotNegative, Number, Pair, PositiveFloat, Table

Share = Annotated[float, Field(ge=-0.2, le=0.2)]
Angle = Annotated[float, Field(ge=-180, le=180)]
Tilt = Annotated[float, Field(ge=-45, le=45)]
DotPlace = Annotated[tuple[int, int], Field(strict=False)]


class TrueOpticsTable(Table):
    """``[simulation.optics]``: what a camera has and its data sheet does not say (``simulation.real_camera``)."""

    stop_mm: Number = 0.0
    rim_radius_mm: PositiveFloat | None = None
    distortion: Share = 0.0
    gap_tilt: Share = 0.0
    gap_tilt_direction_deg: Angle = 0.0
    aspect: Share = 0.0


class PoseTable(Table):
    """``[simulation.pose]``: how the frame of the target lies in the camera's (``simulation.real_camera.Pose``)."""

    turn_deg: Angle = 0.0
    tilt_deg: Annotated[tuple[Tilt, Tilt], Field(strict=False)] = (0.0, 0.0)
    origin_mm: Annotated[tuple[Number, Number, Number], Field(strict=False)] = (0.0, 0.0, 0.0)


class CutDotTable(Table):
    """One of ``simulation.target.cut`` (``simulation.targets.CutDot``)."""

    column: int
    row: int
    direction_deg: Angle = 0.0
    keep: Annotated[float, Field(ge=-1, le=1)] = 0.0


class TrueTargetTable(Table):
    """``[simulation.target]``: what [calibration] does not say of the target (``simulation.targets.DotTarget``)."""

    electrons_per_pixel: PositiveFloat = 3000.0
    background: Annotated[float, Field(ge=0, lt=1)] = 0.02
    half_mm: Pair | None = None
    missing: Annotated[tuple[DotPlace, ...], Field(strict=False)] = ()
    cut: Annotated[tuple[CutDotTable, ...], Field(strict=False)] = ()


class DriftTable(Table):
    """``[simulation.drift]``: of the microlens array since the white image (``cameras.drift.ArrayDrift``)."""

    shift_px: Pair = (0.0, 0.0)
    turn_deg: Angle = 0.0
    scale: Share = 0.0


class SimulationTable(Table):
    """``[simulation]``: flow and light of a synthetic recording. Read by ``plenopiv simulate`` alone, never by a run.

    ``flow`` and its ``parameters`` are those of ``simulation.flows``; light and seeding are explained in
    ``simulation.simulated_recording.Seeding``, noise in ``simulation.sensor_noise.SensorNoise``. The lattice lies where
    [camera.microlens_array] says, the seeded box is [volume] and ``margin_mm`` around it. With [medium], [calibration]
    or one of the tables below but drift, the camera is a ``simulation.real_camera.RealCamera``.
    """

    flow: str
    parameters: dict[str, Any] = Field({})
    particles_per_microlens: PositiveFloat = 1.0
    electrons_per_pixel: PositiveFloat = 400.0
    electrons_spread: NotNegative = 0.25
    diameter_mm: NotNegative = 0.0
    margin_mm: Annotated[tuple[NotNegative, NotNegative, NotNegative], Field(strict=False)] | None = None
    gain: PositiveFloat = 0.5
    read_noise_electrons: NotNegative = 3.0
    shot_noise: bool = True
    diffraction: bool = False
    wavelength_nm: PositiveFloat = 532.0
    rays: Annotated[int, Field(ge=100, le=10_000_000)] = 20_000
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    dark: bool = False
    optics: TrueOpticsTable | None = None
    pose: PoseTable | None = None
    target: TrueTargetTable | None = None
    drift: DriftTable | None = None

    @model_validator(mode="after")
    def _consistent(self) -> SimulationTable:
        if self.target is not None and self.target.half_mm is not None and min(self.target.half_mm) <= 0:
            raise ValueError(f"target.half_mm = {list(self.target.half_mm)}: half sides of a board are positive")
        return self
