"""How long a run will take, estimated before it starts, and how much of that is left.

The constants are times of one core of the machine in docs/speed.md, most fitted to the runs of docs/accuracy.md;
benchmarks/speed/scaling.py has predicted beside measured times. Another machine, or an unusual density of particles,
shows when the first frame is done: what is left is then scaled by the time that it took. Before, ``present`` measures
how fast the machine is at the moment, and whether kernels are compiled.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import log, pi, prod

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.displacement.settings import CorrelationSettings, Pass
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import VoxelGrid

READ = 8.1e-9  # s, a pixel that a voxel is seen by, forward and back in one iteration
TRACE = 2.2e-8  # s, the same in dense ray tracing
EVERY_VOXEL = 8.0e-7  # s, a voxel where all are candidates, until most are left out
DECODE = 1.2e-6  # s, a pixel of an image
WINDOW = 1.4e-8  # s, a voxel of a window in one pass
VECTORS = 0.2  # s, of a pair, whatever its windows
RESAMPLED = 1.7e-8  # s, a voxel of the laboratory's grid, for a volume of which 6 % are listed
START = 5.5  # s, calibration, libraries, report with its figures
FIRST_PAIR = 0.45  # s, of the first pair beyond what others take
OPEN = 6.5e-7  # s, a pixel of the sensor: images that are checked, and stand in the report
TOLD = 1.5  # ratio of speeds from which on it is told


@dataclass(frozen=True)
class TimeEstimate:
    """Seconds of a frame's reconstruction, a pair's correlation, and all else; ``compiling``: of kernels, once.

    ``speed``: of the machine when this was estimated, over that of the constants; None where it was not measured.
    """

    frame: float
    pair: float
    start: float = START
    compiling: float = 0.0
    speed: float | None = None

    def at_speed(self, speed: float, compiling: float = 0.0) -> TimeEstimate:
        """The same on a machine of another speed, which has kernels to compile for ``compiling`` seconds."""
        return TimeEstimate(self.frame / speed, self.pair / speed, self.start / speed, compiling, speed)

    def run(self, frames: int, pairs: int | None = None) -> float:
        """Seconds of a run of so many frames and pairs; each with the next where the number of pairs is left out."""
        return self.start + self.compiling + frames * self.frame + (frames - 1 if pairs is None else pairs) * self.pair

    def left(self, frames: int, took: float, pairs: int | None = None, compiled: float = 0.0) -> float:
        """Seconds left after the first of so many frames, which took ``took``, without the ``compiled`` seconds of
        compilation until now."""
        rest = (frames - 1) * self.frame + (frames - 1 if pairs is None else pairs) * self.pair
        return took / self.frame * rest + max(self.compiling - compiled, 0.0)

    def words(self, frames: int, pairs: int) -> str:
        """What a run of so many frames and pairs takes, and why it takes more or less than elsewhere."""
        text = f"about {as_text(self.run(frames, pairs))}"
        if self.compiling >= 1.0:
            text += f", {self.compiling:.0f} s of it to compile kernels, once on this machine"
        if self.speed is not None and abs(log(self.speed)) > log(TOLD):
            text += f"; this machine has now {100 * self.speed:.0f} % of the speed of that in docs/speed.md"
        return text


def estimate(
    camera: PlenopticCamera,
    grid: VoxelGrid,
    *,
    iterations: int,
    passes: Iterable[Pass],
    threads: int,
    every_voxel: bool = False,
    lens: VoxelGrid | None = None,
) -> TimeEstimate:
    """Estimate the time of a run. ``lens``: the grid of lens space, where vectors are measured on another ``grid``."""
    pair = correlation_s(grid, passes) + 2 * resampling_s(grid, lens)
    grid, sensor = lens or grid, camera.sensor.rows * camera.sensor.columns
    seen = grid.size * pixels_of_voxel(camera, grid)
    frame = iterations * READ * seen + DECODE * sensor
    frame += EVERY_VOXEL * grid.size if every_voxel else TRACE * seen
    return TimeEstimate(frame / threads, pair / threads, START + FIRST_PAIR + OPEN * sensor)


def pixels_of_voxel(camera: PlenopticCamera, grid: VoxelGrid) -> float:
    """How many pixels look at a voxel, as its plane is shared out among those of all microlenses."""
    pitch = camera.lattice.pitch_mm / camera.main_lens.magnification
    microlenses = grid.voxel_mm[0] * grid.voxel_mm[1] / (pitch**2 * camera.lattice.row_spacing)
    return microlenses * pi * camera.aperture_radius_px**2


def resampling_s(grid: VoxelGrid, lens: VoxelGrid | None) -> float:
    """Seconds of one core for a volume on another ``grid`` than that of lens space, where it was reconstructed."""
    return 0.0 if lens is None or lens == grid else RESAMPLED * grid.size


def correlation_s(grid: VoxelGrid, passes: Iterable[Pass]) -> float:
    """Seconds of one core for a pair's passes."""
    from plenopiv.displacement.transforms import fast_length
    from plenopiv.displacement.windows import step_of

    pair = VECTORS
    for window, overlap in passes:
        along = zip(grid.shape[::-1], window, strict=True)
        count = prod(max(1, (total - n) // step_of(n, overlap) + 1) for total, n in along)
        pair += WINDOW * count * prod(map(fast_length, window))
    return pair


def of_settings(
    camera: PlenopticCamera,
    grid: VoxelGrid,
    reconstruction: ReconstructionSettings,
    correlation: CorrelationSettings,
    threads: int,
    lens: VoxelGrid | None = None,
) -> TimeEstimate:
    """``estimate`` of a run with these settings."""
    return estimate(
        camera,
        grid,
        iterations=reconstruction.iterations,
        passes=correlation.passes,
        threads=threads,
        every_voxel=reconstruction.method == "mart",
        lens=lens,
    )


def as_text(seconds: float) -> str:
    """A duration as text: in seconds, minutes or hours."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
