"""Water behind glass: errors of recordings whose experiment file states [medium], against the same flow in air.

    python benchmarks/accuracy/windows.py [NAME ...] [--pairs N] [--out DIR] [--again] [--simulate-only]

The camera of conditions.py's ``base``, twice as high, before 10, 60 and 100 mm of water and 10 mm of glass, straight
and turned by 2 degrees; rays are traced through all of it, and the file states what is there. The flow is a shear of
all components, which windows resolve: slopes are the camera's, not the windows'. It, the volume and the voxels are
those of the case in air seen through the window: depths longer by the refractive index, the middle where the camera's
axis is in focus, which spherical aberration moves by 0.2 mm behind 100 mm of water. So all cases move as many voxels,
vectors lie as near to focus, where depth is known least, and errors in voxels compare.

A recording is made once and kept in DIR/NAME. Results are added to windows.json: RMS and bias along x, y, z in voxels,
share of gross errors and of answered vectors, the slope of measured on true displacement with its standard deviation,
of windows that lie whole beyond two half dead zones from focus, and RMS and slope over those in air.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from conditions import CONDITIONS, DT_S, Condition
from numpy.typing import NDArray

import plenopiv
from plenopiv.accuracy import score_velocity
from plenopiv.accuracy.truth import true_displacements
from plenopiv.accuracy.velocity import GROSS_VOXELS, Score, pooled
from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.lens_space import behind_window, images_of
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.simulation.flows import Velocity
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_images import sight_lines
from plenopiv.simulation.real_recording import simulate_real_recording
from plenopiv.volume import Limits

HERE = Path(__file__).parent
RECORDED = HERE / "windows.json"
WATER, GLASS, GLASS_MM = 1.333, 1.52, 10.0
PAIRS = 2
SPARE_MM = 0.1  # of the volume on each side: turned windows move what the camera sees
# Of the base itself only four windows lie within its height: at the edges w changes by 1 to 2 % too little along y.
BASE: Condition = replace(CONDITIONS["base"], seed=11, rows=1600)
DRIFT = (0.3, -0.7, 1.37)  # voxels along x, y, z
CHANGE = ((0.0, 4.0, 2.0), (5.0, 0.0, 0.0), (3.0, 2.0, 0.0))  # of u, v, w from the middle to the ends of x, y, z
BEYOND = 2.0  # half dead zones


def water(fluid_mm: float, *tilt_deg: float) -> Medium:
    """Water and 10 mm of glass, turned about x and y."""
    return Medium(WATER, fluid_mm, GLASS_MM, GLASS, tilt_deg or (0.0, 0.0))


CASES: dict[str, Medium | None] = {
    "air": None,
    "water10": water(10.0),
    "water10-turned": water(10.0, 2.0, -2.0),
    "water60": water(60.0),
    "water60-turned": water(60.0, -2.0, 2.0),
    "water100": water(100.0),
    "water100-turned": water(100.0, 2.0, 2.0),
    "water100-back": water(100.0, -2.0, -2.0),
}


@dataclass(frozen=True)
class Seen:
    """Lengths in a fluid as a camera in air sees them: depths shorter by ``index``, ``centre_mm`` (x, y, z) the
    middle."""

    index: float
    centre_mm: tuple[float, float, float]

    @classmethod
    def through(cls, camera: RealCamera) -> Seen:
        """What a camera sees, about the point of its axis that is in focus."""
        if camera.medium is None:
            return cls(1.0, (0.0, 0.0, 0.0))
        index = camera.medium.refractive_index
        point, direction = sight_lines(camera, (0.0, 0.0), (0.0, 0.0))
        depths = np.array([0.0, index])
        places = point + direction * ((depths[:, None] - point[:, 2:]) / direction[:, 2:])
        near, far = images_of(places, behind_window(BASE.camera(), camera.medium), BASE.camera()).place_mm[:, 2]
        x, y, z = (places[0] - near / (far - near) * (places[1] - places[0])).tolist()
        return cls(index, (x, y, z))

    def points(self, laboratory_mm: NDArray) -> NDArray[np.float64]:
        """Points (n, 3) of the laboratory as they seem to lie."""
        return (np.asarray(laboratory_mm, float) - self.centre_mm) / (1.0, 1.0, self.index)

    def limits(self, seen_mm: Limits) -> Limits:
        """The volume of the laboratory that seems to be this one."""
        sides = zip(seen_mm, self.centre_mm, (1.0, 1.0, self.index), strict=True)
        x, y, z = ((n * lo + middle, n * hi + middle) for (lo, hi), middle, n in sides)
        return x, y, z

    def field(self, velocity: xr.Dataset) -> xr.Dataset:
        """A velocity field of the laboratory as it seems to be."""
        x, y, z = self.centre_mm
        seen = velocity.assign_coords(x=velocity.x - x, y=velocity.y - y, z=(velocity.z - z) / self.index)
        return seen.assign({name: seen[name] / self.index for name in ("w", "w_raw", "w_std") if name in seen})


@dataclass(frozen=True)
class FlowSeen:
    """The flow of the laboratory that seems to be ``flow``: free of divergence if that is."""

    flow: Velocity
    seen: Seen

    def __call__(self, points_mm: NDArray) -> NDArray:
        """Velocity in m/s at points (n, 3) in mm."""
        return self.flow(self.seen.points(points_mm)) * (1.0, 1.0, self.seen.index)


def flow_in_air() -> Velocity:
    """The flow of the case in air, in m/s at points in mm: u, v and w change evenly, each across the others' axes."""
    voxel, ends = np.array(BASE.voxel_mm()), np.array([side[1] for side in BASE.volume_mm()])
    return lambda points_mm: (DRIFT + (points_mm / ends) @ np.transpose(CHANGE)) * voxel * (1e-3 / DT_S)


def case_camera(name: str) -> RealCamera:
    """The camera of a case with what stands before it."""
    return RealCamera.of(BASE.camera(), medium=CASES[name])


def simulate(name: str, folder: Path, pairs: int) -> None:
    """Make the recording."""
    camera = case_camera(name)
    seen = Seen.through(camera)
    x, y, z = BASE.volume_mm()
    inside = (x[0] + SPARE_MM, x[1] - SPARE_MM), (y[0] + SPARE_MM, y[1] - SPARE_MM), z
    dx, dy, dz = BASE.voxel_mm()
    simulate_real_recording(
        folder,
        camera,
        FlowSeen(flow_in_air(), seen),
        dt_s=DT_S,
        volume_mm=seen.limits(inside),
        pairs=pairs,
        voxel_mm=(dx, dy, dz * seen.index),
        windows=BASE.windows,
        seed=BASE.seed,
    )


def particles(folder: Path, pairs: int, pair: int) -> tuple[NDArray, NDArray]:
    """Particles (n, 3) in both frames of a pair, counted from 0."""
    name = "truth_particles.npz" if pairs == 1 else f"truth_particles_{pair + 1:04d}.npz"
    with np.load(folder / name) as found:
        return found["a"], found["b"]


def on_truth(field: xr.Dataset, a: NDArray, b: NDArray, camera: PlenopticCamera) -> tuple[NDArray, NDArray]:
    """True and measured displacements (n, 3) in voxels of vectors whose windows every view sees and lie whole beyond
    BEYOND half dead zones from focus, but gross errors."""
    voxel = np.array(BASE.voxel_mm())
    half = 0.5 * voxel * BASE.windows[-1]
    z, y, x = np.meshgrid(field.z, field.y, field.x, indexing="ij")
    at = np.stack([x, y, z], -1).reshape(-1, 3)
    middle = 0.5 * (a + b)
    x_seen, y_seen = seen_by_every_view_mm(camera, at[:, 2])
    kept = ((at >= middle.min(0) + half) & (at <= middle.max(0) - half)).all(1)
    kept &= np.abs(at[:, 2]) - half[2] > BEYOND * 0.5 * np.ptp(camera.dead_zone_mm())
    kept &= (np.abs(at[:, 0]) + half[0] <= x_seen) & (np.abs(at[:, 1]) + half[1] <= y_seen)
    true = true_displacements(at[kept], a, b, half).window / voxel
    measured = np.stack([field[name].values.reshape(-1)[kept] for name in "uvw"], -1) * (1e3 * DT_S / voxel)
    fine = np.isfinite(true).all(1) & (np.abs(measured - true) <= GROSS_VOXELS).all(1)
    return true[fine], measured[fine]


def slopes(true: NDArray, measured: NDArray) -> dict[str, list[float]]:
    """Slope of measured on true displacement along x, y, z, and its standard deviation."""
    fits = [np.polyfit(t, m, 1, cov=True) for t, m in zip(true.T, measured.T, strict=True)]
    return {"slope": [float(p[0]) for p, _ in fits], "slope_std": [float(np.sqrt(c[0, 0])) for _, c in fits]}


def measure(name: str, folder: Path) -> dict[str, Any]:
    """Run a recording and score it."""
    experiment = Experiment.load(folder / "experiment.toml")
    seen, camera = Seen.through(case_camera(name)), BASE.camera()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PlenoPIVWarning)
            velocity = plenopiv.process(experiment, overwrite=True).velocity
    except PlenoPIVError as error:
        return {"error": str(error)}
    scores, true, measured = list[Score](), [], []
    for pair in range(velocity.sizes["time"]):
        a, b = (seen.points(positions) for positions in particles(folder, velocity.sizes["time"], pair))
        field = seen.field(velocity.isel(time=pair))
        scores.append(
            score_velocity(field, a, b, camera, dt_s=DT_S, voxel_mm=BASE.voxel_mm(), window_voxels=BASE.windows[-1])
        )
        for kept, more in zip((true, measured), on_truth(field, a, b, camera), strict=True):
            kept.append(more)
    errors = pooled(scores)
    return {
        "pairs": len(scores),
        "vectors": sum(score.vectors for score in scores),
        "answered": errors.answered,
        "gross": errors.gross,
        "rms": errors.rms,
        "bias": errors.bias,
        **slopes(np.concatenate(true), np.concatenate(measured)),
        "true_rms": np.sqrt(np.mean(np.concatenate(true) ** 2, 0)).tolist(),
    }


def one_line(name: str, result: dict[str, Any]) -> str:
    """What a person wants to read of a case."""
    if "error" in result:
        return f"{name:16s} {result['error']}"

    def three(key: str) -> str:
        return " ".join(f"{value:+.4f}" if key == "bias" else f"{value:.4f}" for value in result.get(key, ()))

    return (
        f"{name:16s} rms {three('rms')}  over air {three('rms_over_air')}  bias {three('bias')}  "
        f"slope {three('slope')} +- {three('slope_std')}  over air {three('slope_over_air')}  "
        f"gross {100 * result['gross']:.2f} %  answered {100 * result['answered']:.1f} %  {result['vectors']} vectors"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(CASES))
    parser.add_argument("--pairs", type=int, default=PAIRS, metavar="N", help="of a recording that is made")
    parser.add_argument("--out", type=Path, default=Path("build/windows"), metavar="DIR")
    parser.add_argument("--again", action="store_true", help="make recordings anew")
    parser.add_argument("--simulate-only", action="store_true", help="make the recordings and stop")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(CASES):
        parser.error(f"no case is called {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    results: dict[str, Any] = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}
    for name in arguments.names or CASES:
        folder = arguments.out / name
        if arguments.again or not (folder / "experiment.toml").exists():
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "experiment.toml").unlink(missing_ok=True)
            simulate(name, folder, arguments.pairs)
        if arguments.simulate_only:
            continue
        results[name] = result = measure(name, folder)
        if "rms" in result and "rms" in results.get("air", {}):
            for key in ("rms", "slope"):  # the same particles are seen: most of what slopes scatter by is common
                pairs = zip(result[key], results["air"][key], strict=True)
                result[f"{key}_over_air"] = [there / in_air for there, in_air in pairs]
        print(one_line(name, result))
        sys.stdout.flush()
        RECORDED.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
