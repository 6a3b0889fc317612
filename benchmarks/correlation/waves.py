"""How much of a wave in the flow vectors keep, by wavelength, axis and setting. Writes waves.json and its table.

    python benchmarks/correlation/waves.py [exact|reconstructed] [--anew]

``exact``: volumes of Gaussian particles (``volumes.py``), 36 in a window of 64 x 64 x 16 voxels. ``reconstructed``:
recordings of the camera of benchmarks/accuracy, 8 mm deep, vectors beyond 1.5 half dead zones. Waves of .7 voxel along
each axis, of displacements along and across depth, on a drift of (2.3, -1.4, .37) voxels; amplitudes are those of the
true wave in the vectors. Goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import volumes

from plenopiv.displacement.field import DisplacementField
from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.resolution import effective_window, response
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVWarning
from plenopiv.volume import DenseVolume, VoxelGrid

HERE = Path(__file__).parent
RECORDED, PAGE = HERE / "waves.json", HERE.parents[1] / "docs" / "resolution.md"
DEFAULT = CorrelationSettings()
SETTINGS = {
    "default: sub-windows 48 x 48 x 13": DEFAULT,
    "sub-windows 48 x 48 x 12": replace(DEFAULT, inner_window=(48, 48, 12)),
    "sub-windows 40 x 40 x 10": replace(DEFAULT, inner_window=(40, 40, 10)),
    "no sub-windows": replace(DEFAULT, inner_window=DEFAULT.windows[-1]),
}
WAVES = (1.0, 1.5, 2.0, 3.0, 4.0)  # windows
AMPLITUDE, DRIFT = 0.7, np.array([2.3, -1.4, 0.37])  # voxels
COMPONENTS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))  # axis of the wave, displacement
SEEDS = 3
SHAPES = ((80, 160, 384), (80, 384, 160), (112, 160, 192))  # of volumes with a wave along x, y, z
BEYOND_HALF_DEAD_ZONES = 1.5


def amplitudes(field: DisplacementField, wave: np.ndarray, across: int, axis: int, kept: np.ndarray) -> np.ndarray:
    """Sums of measured and of true displacement times the true wave, over vectors a window from the ends of the axis
    that are ``kept``."""
    place = np.meshgrid(field.z, field.y, field.x, indexing="ij")[2 - axis]
    far = (place > place.min() + 0.5 * DEFAULT.windows[-1][axis]) & (
        place < place.max() - 0.5 * DEFAULT.windows[-1][axis]
    )
    inside = far & kept
    moved, true = (field.displacement[across] - DRIFT[across])[inside], wave[inside]
    return np.array([moved @ true, true @ true])


def of_exact(settings: CorrelationSettings, axis: int, across: int, wavelength: float) -> float:
    """Measured over true amplitude in volumes of Gaussian particles."""
    shape, sums, k = SHAPES[axis], np.zeros(2), 2 * np.pi / wavelength
    middle = (np.array(shape[::-1]) - 1) / 2
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        phase = rng.uniform(0, 2 * np.pi)

        def wave(place: np.ndarray, phase: float = phase) -> np.ndarray:
            return AMPLITUDE * np.sin(k * (place - middle[axis]) + phase)

        def flow(at: np.ndarray, wave: Any = wave) -> np.ndarray:
            return DRIFT + wave(at[:, axis, None]) * (np.arange(3) == across)

        grid = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), shape)
        pair = (DenseVolume(grid, values) for values in volumes.particle_pair(shape, flow, rng))
        field = measure(*pair, settings)
        place = np.meshgrid(field.z, field.y, field.x, indexing="ij")[2 - axis]
        sums += amplitudes(field, wave(place), across, axis, np.ones(place.shape, bool))
    return float(sums[0] / sums[1])


def reconstructed_pairs(axis: int, across: int, windows: float) -> Any:
    """A recording of one wave, its chain and both volumes, and the wave at places in mm."""
    sys.path.insert(0, str(HERE.parent / "accuracy"))
    from conditions import CONDITIONS, DT_S

    from plenopiv.experiment import Experiment
    from plenopiv.run.calibrated import calibrated_chain
    from plenopiv.run.frame import reconstructed
    from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

    condition = CONDITIONS["base"]
    if axis == 1:  # the longer side along the wave
        condition = replace(condition, columns=condition.rows, rows=condition.columns)
    voxel = np.array(condition.voxel_mm())
    k = 2 * np.pi / (windows * DEFAULT.windows[-1][axis] * voxel[axis])
    phase = np.random.default_rng(7).uniform(0, 2 * np.pi)

    def wave(place_mm: np.ndarray) -> np.ndarray:
        return AMPLITUDE * np.sin(k * place_mm + phase)

    def velocity(at_mm: np.ndarray, _time_s: float = 0.0) -> np.ndarray:
        moved = DRIFT + wave(at_mm[:, axis, None]) * (np.arange(3) == across)
        return moved * voxel * 1e-3 / DT_S

    with tempfile.TemporaryDirectory() as folder:
        simulate_recording(
            folder, condition.camera(), velocity, dt_s=DT_S, volume_mm=condition.volume_mm(), seeding=Seeding(),
            voxel_mm=condition.voxel_mm(), windows=condition.windows, seed=3, overwrite=True,
        )  # fmt: skip
        experiment = Experiment.load(Path(folder) / "experiment.toml")
        chain, recording, _ = calibrated_chain(experiment, experiment.recording())
        pair = [reconstructed(chain, recording, n, lambda *done: None).found.volume for n in recording.pairs[0]]
    return chain, pair, wave


def of_reconstructed(chain: Any, pair: Any, wave: Any, settings: CorrelationSettings, axis: int, across: int) -> float:
    """Measured over true amplitude in reconstructed volumes."""
    field = replace(chain, correlation=settings).displacement(*pair)
    grid = chain.grid
    axes = np.meshgrid(field.z, field.y, field.x, indexing="ij")[::-1]
    x, y, z = (a * d + first for a, d, first in zip(axes, grid.voxel_mm, grid.first_mm, strict=True))
    beyond = np.abs(z) > BEYOND_HALF_DEAD_ZONES * max(np.abs(chain.camera.dead_zone_mm()))
    sums = amplitudes(field, wave((x, y, z)[axis]), across, axis, beyond)
    return float(sums[0] / sums[1])


def page(found: dict[str, dict[str, float]]) -> str:
    """The tables between the page's marks."""
    lines = []
    for kind, title in (("exact", "Exact volumes"), ("reconstructed", "Reconstructed volumes")):
        rows = {name for name in found if name.startswith(kind)}
        if not rows:
            continue
        lines += [f"**{title}**", "", "| setting | wave along, of | " + " | ".join(f"{w:g}" for w in WAVES) + " |"]
        lines += ["|---|---|" + "---:|" * len(WAVES)]
        for label, settings in SETTINGS.items():
            for axis, across in COMPONENTS:
                got = [found.get(key(kind, label, axis, across, w)) for w in WAVES]
                if any(value is not None for value in got):
                    cells = " | ".join("" if value is None else f"{value:.3f}" for value in got)
                    lines.append(f"| {label} | {'xyz'[axis]}, {'uvw'[across]} | {cells} |")
            for axis in (0, 2) if kind == "exact" else ():
                model = [response(settings, axis, w * settings.windows[-1][axis]) for w in WAVES]
                lines.append(f"| | {'xyz'[axis]}, computed | " + " | ".join(f"{value:.3f}" for value in model) + " |")
        lines.append("")
    lines += ["| setting | effective window, voxels |", "|---|---|"]
    for label, settings in SETTINGS.items():
        lines.append(f"| {label} | " + " x ".join(f"{side:.1f}" for side in effective_window(settings)) + " |")
    box = " | ".join(f"{np.sinc(1 / w):.3f}" for w in WAVES)
    return "\n".join([f"Mean over the window itself: {box.replace(' | ', ', ')} at {WAVES} windows.", "", *lines])


def key(kind: str, label: str, axis: int, across: int, windows: float) -> str:
    return f"{kind}|{label}|{'xyz'[axis]}|{'uvw'[across]}|{windows:g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=["exact", "reconstructed"])
    parser.add_argument("--anew", action="store_true")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", PlenoPIVWarning)
    volumes.PARTICLES_A_WINDOW = 36 * volumes.WINDOW**3 / (64 * 64 * 16)
    found = json.loads(RECORDED.read_text()) if RECORDED.exists() and not arguments.anew else {}
    for kind in arguments.kinds:
        for axis, across in COMPONENTS if kind == "exact" else ((0, 1), (1, 2), (2, 0)):
            for windows in WAVES[1:4] if kind == "reconstructed" else WAVES:
                missing = [n for n in SETTINGS if key(kind, n, axis, across, windows) not in found]
                if not missing:
                    continue
                made = reconstructed_pairs(axis, across, windows) if kind == "reconstructed" else None
                for label in missing:
                    settings, wavelength = SETTINGS[label], windows * DEFAULT.windows[-1][axis]
                    value = (
                        of_exact(settings, axis, across, wavelength)
                        if made is None
                        else of_reconstructed(*made, settings, axis, across)
                    )
                    found[key(kind, label, axis, across, windows)] = round(value, 4)
                    print(key(kind, label, axis, across, windows), round(value, 3), flush=True)
                RECORDED.write_text(json.dumps(found, indent=1) + "\n")
    text = PAGE.read_text()
    before, rest = text.split("<!-- response: begin -->\n")
    _, after = rest.split("<!-- response: end -->")
    PAGE.write_text(f"{before}<!-- response: begin -->\n{page(found)}\n<!-- response: end -->{after}")


if __name__ == "__main__":
    main()
