"""The conditions under which accuracy is measured: camera, lattice, flow, depth, seeding, light and noise, as data.

Displacements are given in voxels per frame, which is what errors are judged in; ``Condition.flow`` turns them into m/s.
The first five stand alone; the others change one thing at a time from ``base``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import floor, radians, sqrt

from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice, LatticeKind
from plenopiv.sensor import Sensor
from plenopiv.simulation.experiment_file import default_voxel_mm
from plenopiv.simulation.flows import Velocity, flow
from plenopiv.simulation.particles import Limits
from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

DT_S = 0.0005
RING_PEAK = 0.30  # fastest point of the ring below, in circulations a mm
PIXEL_MM = 0.0055
FOCAL_LENGTH_MM, MICROLENS_FOCAL_LENGTH_MM = 50.0, 0.308
OFFSET_MM = (0.0306, 0.0212)  # of the lattice: no microlens on the axis


@dataclass(frozen=True)
class Condition:
    """One recording's settings.

    ``drift_voxels``: displacement along x, y, z that is added to the flow. ``strength`` means what the flow says:
    uniform, nothing; shear, voxels of x displacement at the near end of the volume; ring, peak in-plane voxels; abc,
    RMS in-plane voxels. The main lens' aperture is the matched one. ``x_mm``, ``y_mm``: half widths of the volume; None
    takes what every view sees at all depths, down to a tenth of a millimetre.
    """

    varies: str
    flow_name: str = "shear"
    strength: float = 5.0
    drift_voxels: tuple[float, float, float] = (0.3, 2.7, 1.37)
    columns: int = 1000
    rows: int = 800
    lattice: LatticeKind = "hexagonal"
    pixels_per_microlens: int = 14
    rotation_deg: float = 0.1
    magnification: float = -1.0
    z_mm: tuple[float, float] = (-4.0, 4.0)
    x_mm: float | None = None
    y_mm: float | None = None
    particles_per_microlens: float = 1.0
    electrons_per_pixel: float = 400.0
    read_noise_electrons: float = 3.0
    gain: float = 0.5
    diameter_mm: float = 0.0
    windows: tuple[tuple[int, int, int], ...] = ((128, 128, 32), (64, 64, 16))
    seed: int = field(default=7, kw_only=True)

    def camera(self) -> PlenopticCamera:
        """The camera with its true lattice."""
        pitch = self.pixels_per_microlens * PIXEL_MM
        lattice = Lattice(self.lattice, pitch, radians(self.rotation_deg), OFFSET_MM)
        sensor = Sensor(self.columns, self.rows, PIXEL_MM, 12, 60)
        lens = MainLens(FOCAL_LENGTH_MM, 1.0, self.magnification)
        unmatched = PlenopticCamera(lens, lattice, MICROLENS_FOCAL_LENGTH_MM, sensor)
        return replace(unmatched, main_lens=replace(lens, aperture_mm=unmatched.matched_aperture_mm))

    def voxel_mm(self) -> tuple[float, float, float]:
        """Voxel along x, y, z."""
        return default_voxel_mm(self.camera())

    def volume_mm(self) -> Limits:
        """Limits ((x lo, hi), (y lo, hi), (z lo, hi)) of the reconstructed volume."""
        seen = [floor(10 * float(min(side))) / 10 for side in seen_by_every_view_mm(self.camera(), self.z_mm)]
        x, y = self.x_mm or seen[0], self.y_mm or seen[1]
        return (-x, x), (-y, y), self.z_mm

    def flow(self) -> Velocity:
        """Velocity in m/s at points in mm."""
        voxel = self.voxel_mm()
        m_s = [d * v * 1e-3 / DT_S for d, v in zip(self.drift_voxels, voxel, strict=True)]
        in_plane = self.strength * voxel[0] / DT_S  # mm/s
        if self.flow_name == "uniform":
            return flow("uniform", velocity_m_s=m_s)
        if self.flow_name == "shear":
            return flow("shear", rate_per_s=in_plane / self.z_mm[1], drift_m_s=m_s)
        if self.flow_name == "vortex-ring":
            return flow(
                "vortex-ring",
                radius_mm=1.6,
                core_radius_mm=0.5,
                axis="x",
                circulation_mm2_s=in_plane / RING_PEAK,
                drift_m_s=m_s,
            )
        # u, v: amplitude^2 (1 + 0.3^2)/2 = strength^2; w follows from the same amplitudes
        amplitude = in_plane * 1e-3 * sqrt(2.0 / 1.09)
        return flow("abc", wavelength_mm=4.8, amplitudes_m_s=(0.3 * amplitude, amplitude, amplitude), drift_m_s=m_s)

    def simulate(self, directory) -> None:
        """Write the recording's folder."""
        simulate_recording(
            directory,
            self.camera(),
            self.flow(),
            dt_s=DT_S,
            volume_mm=self.volume_mm(),
            seeding=Seeding(
                particles_per_microlens=self.particles_per_microlens,
                electrons_per_pixel=self.electrons_per_pixel,
                diameter_mm=self.diameter_mm,
            ),
            noise=SensorNoise(self.gain, self.read_noise_electrons),
            voxel_mm=self.voxel_mm(),
            windows=self.windows,
            seed=self.seed,
        )


LARGE = {"columns": 1800, "rows": 1350}
SHIFT = (5.3, -3.4, 1.37)  # voxels along x, y, z: no whole numbers

BASE = Condition("base: shear of 5 voxels along z, hexagonal, PMR 14, M = -1, 8 mm deep, 1 ppm, 400 electrons")
DIM_UNIFORM = Condition(
    "dim: 80 electrons a lit pixel, read noise 5",
    "uniform",
    drift_voxels=SHIFT,
    rotation_deg=0.4,
    x_mm=4.4,
    y_mm=3.2,
    electrons_per_pixel=80.0,
    read_noise_electrons=5.0,
    **LARGE,
)

CONDITIONS: dict[str, Condition] = {
    "dim-uniform": DIM_UNIFORM,
    "dim-uniform-gain1": replace(DIM_UNIFORM, varies=DIM_UNIFORM.varies + ", 1 count an electron", gain=1.0),
    "abc": Condition("ABC flow of 4.8 mm wavelength", "abc", 3.0, (0.0, 0.0, 1.8), x_mm=4.4, y_mm=3.2, **LARGE),
    "square-half": Condition(
        "square lattice, M = -0.5, 24 mm deep",
        "shear",
        6.0,
        (0.3, 2.7, 0.8),
        columns=1400,
        rows=1100,
        lattice="square",
        magnification=-0.5,
        z_mm=(-12.0, 12.0),
    ),
    "ring": Condition("vortex ring", "vortex-ring", 4.0, (0.4, -0.7, 0.6), x_mm=4.4, y_mm=3.2, **LARGE),
    "deep": Condition("20 mm deep, uniform", "uniform", drift_voxels=SHIFT, z_mm=(-10.0, 10.0), **LARGE),
    "full": Condition(
        "the paper's full size: 6600 x 4400 px, 36 x 24 x 20 mm, uniform",
        "uniform",
        drift_voxels=SHIFT,
        columns=6600,
        rows=4400,
        z_mm=(-10.0, 10.0),
        x_mm=18.0,
        y_mm=12.0,
    ),
    "base": BASE,
    "uniform": replace(BASE, varies="flow: uniform", flow_name="uniform", drift_voxels=SHIFT),
    "vortex-ring": replace(BASE, varies="flow: vortex ring", flow_name="vortex-ring", strength=4.0),
    "pmr8": replace(BASE, varies="PMR 8", pixels_per_microlens=8),
    "pmr28": replace(BASE, varies="PMR 28", pixels_per_microlens=28),
    "ppm0.25": replace(BASE, varies="0.25 ppm", particles_per_microlens=0.25),
    "ppm0.5": replace(BASE, varies="0.5 ppm", particles_per_microlens=0.5),
    "ppm2": replace(BASE, varies="2 ppm", particles_per_microlens=2.0),
    "square": replace(BASE, varies="square lattice", lattice="square"),
    "half": replace(BASE, varies="M = -0.5, 24 mm deep", magnification=-0.5, z_mm=(-12.0, 12.0)),
    "depth20": replace(BASE, varies="20 mm deep, sensor 1800 x 1350", z_mm=(-10.0, 10.0), **LARGE),
    "dim": replace(BASE, varies="dim: 80 electrons, read noise 5", electrons_per_pixel=80.0, read_noise_electrons=5.0),
    "rotation0": replace(BASE, varies="lattice rotation 0", rotation_deg=0.0),
    "rotation0.5": replace(BASE, varies="lattice rotation 0.5 degrees", rotation_deg=0.5),
    "rotation1": replace(BASE, varies="lattice rotation 1 degree", rotation_deg=1.0),
}
