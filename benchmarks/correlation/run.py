"""The correlation alone, on volumes of particles of known displacement:  run.py [--pairs N] [--no-peer]

Uniform sub-voxel shifts, the same with particles lost and ghosts, and sinusoidal shear, through the functions that
`plenopiv run` calls; beside them OpenPIV's 3D correlation on the same volumes. OpenPIV (GPL) is installed into
build/openpiv and runs there as a process of its own. Each of the two uses one thread. Prints two tables and writes them
to results.md and results.json beside this file.
"""

from __future__ import annotations

import os

os.environ["NUMBA_NUM_THREADS"] = "1"  # CPU-seconds of one thread each: hyperthreads would blur them

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scores import BIAS_AIM, RMS_AIM, Row, row, shift_table, three, wave_table
from volumes import BRIGHTNESS_SPREAD, PARTICLES_A_WINDOW, SIGMA, WINDOW, Flow, Shape, particle_pair

from plenopiv.accuracy.velocity import GROSS_VOXELS
from plenopiv.displacement.compression import compressed
from plenopiv.displacement.multigrid import OnePair, first_pass, measure
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVWarning
from plenopiv.volume import DenseVolume, VoxelGrid

HERE = Path(__file__).parent
PEER = "openpiv==0.26.0"
PEER_ENVIRONMENT = HERE.parents[1] / "build" / "openpiv"
# windows by themselves, as the peer has them; all else by default
SETTINGS = CorrelationSettings(windows=((WINDOW,) * 3,), inner_window=(WINDOW,) * 3, fine_passes=3)
GHOSTLY = replace(SETTINGS, agreement=4.0, intensity_exponent=1.0)  # for uniform flows and many ghosts
STEP = round(WINDOW * (1 - SETTINGS.overlap))

SEED = 11  # settings were chosen on other volumes
SHIFT_SHAPE: Shape = (128, 160, 160)
LARGEST_SHIFT = 4.0  # voxels
DISTURBANCES = {"uniform shift": (0.0, 0.0), "uniform shift, 30 % lost, 30 % ghosts": (0.3, 0.3)}
WAVE_SHAPE: Shape = (64, 384, 96)
WAVE_AMPLITUDE = 1.5  # voxels
WAVELENGTHS = (2, 3, 4)  # windows

Pair = tuple[NDArray, ...]  # the first and the second volume (nz, ny, nx)
Measured = tuple[dict[str, NDArray], float]  # displacements (3, nz, ny, nx) by name; CPU-seconds
Method = Callable[[Pair], Measured]


def single_pass(pair: Pair) -> Measured:
    """The first pass of `run`: vectors validated once, then found again between windows offset by whole voxels."""
    a, b = dense(pair)
    windows = window_grid(a.grid.shape, (WINDOW,) * 3, SETTINGS.overlap)
    begin = time.process_time()
    a, b = (compressed(volume, SETTINGS.intensity_exponent) for volume in (a, b))
    result = first_pass(OnePair(a, b), windows, SETTINGS)
    seconds = time.process_time() - begin
    return {"PlenoPIV, one pass": np.where(result.found, result.displacement, np.nan)}, seconds


def all_passes(pair: Pair, settings: CorrelationSettings = SETTINGS, note: str = "") -> Measured:
    """All passes of `run`, before and after the last validation."""
    a, b = dense(pair)
    begin = time.process_time()
    with warnings.catch_warnings():
        # a wrong vector at an edge, where too few neighbours judge it, brings advice on window sizes
        warnings.simplefilter("ignore", PlenoPIVWarning)
        field = measure(a, b, settings)
    seconds = time.process_time() - begin
    name = f"PlenoPIV, {settings.fine_passes} passes{note}"
    return {name: field.raw, f"{name}, validated": field.displacement}, seconds


def against_ghosts(pair: Pair) -> Measured:
    """All passes, places counted by how far both volumes agree."""
    return all_passes(pair, GHOSTLY, f", agreement {GHOSTLY.agreement:g}, exponent {GHOSTLY.intensity_exponent:g}")


def dense(pair: Pair) -> tuple[DenseVolume, ...]:
    return tuple(DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, v.shape), v) for v in pair)


class OpenPIV:
    """The peer's process; called like the functions above."""

    def __init__(self, folder: Path) -> None:
        python = PEER_ENVIRONMENT / "bin" / "python"
        if not python.exists():
            subprocess.run([sys.executable, "-m", "venv", PEER_ENVIRONMENT], check=True)
        if subprocess.run([python, "-c", "import openpiv"], stderr=subprocess.DEVNULL).returncode:
            subprocess.run([python, "-m", "pip", "install", "--quiet", PEER], check=True)
        self.folder = folder
        self.process = subprocess.Popen(
            [python, HERE / "openpiv_peer.py", str(WINDOW), str(STEP)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"TQDM_DISABLE": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        self.version = self._line()

    def __call__(self, pair: Pair) -> Measured:
        for name, values in zip("ab", pair, strict=True):
            np.save(self.folder / f"{name}.npy", values)
        print(self.folder, file=self.process.stdin, flush=True)
        seconds = float(self._line())
        return {"OpenPIV": np.load(self.folder / "d.npy")}, seconds

    def _line(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline().strip()
        if not line:
            raise SystemExit("OpenPIV's process ended; what it said stands above")
        return line


def shift_pairs(count: int, lost: float, ghosts: float) -> Iterator[tuple[Pair, Flow]]:
    for number in range(count):
        rng = np.random.default_rng([SEED, 1, number])
        shift = rng.uniform(-LARGEST_SHIFT, LARGEST_SHIFT, 3)

        def flow(p: NDArray, shift: NDArray = shift) -> NDArray:
            return np.broadcast_to(shift, p.shape)

        yield particle_pair(SHIFT_SHAPE, flow, rng, lost, ghosts), flow


def wave_pairs(count: int, windows: int) -> Iterator[tuple[Pair, Flow]]:
    """Displacement along x that varies as a sine along y."""
    for number in range(count):
        rng = np.random.default_rng([SEED, 2, windows, number])
        phase = rng.uniform(0, 2 * np.pi)

        def flow(p: NDArray, phase: float = phase) -> NDArray:
            d = np.zeros_like(p)
            d[:, 0] = WAVE_AMPLITUDE * np.sin(2 * np.pi * p[:, 1] / (windows * WINDOW) + phase)
            return d

        yield particle_pair(WAVE_SHAPE, flow, rng), flow


def at_centres(flow: Flow, shape: Shape) -> NDArray[np.float64]:
    """The true displacement (3, nz, ny, nx) at the window centres."""
    z, y, x = np.meshgrid(*window_grid(shape, (WINDOW,) * 3, SETTINGS.overlap).centres, indexing="ij")
    return flow(np.stack([x.ravel(), y.ravel(), z.ravel()], -1)).T.reshape(3, *z.shape)


def scored(condition: str, methods: list[Method], pairs: Iterator[tuple[Pair, Flow]]) -> list[Row]:
    """One row for every name that a method returns; a pair is measured by all methods before the next one is made."""
    truths: list[NDArray] = []
    found: dict[str, list[NDArray]] = {}
    seconds: dict[str, float] = {}
    for pair, flow in pairs:
        truths.append(at_centres(flow, pair[0].shape))
        for method in methods:
            displacements, spent = method(pair)
            for name, displacement in displacements.items():
                found.setdefault(name, []).append(displacement)
                seconds[name] = seconds.get(name, 0.0) + spent
    truth = np.stack(truths)
    return [row(condition, name, np.stack(d), truth, seconds[name]) for name, d in found.items()]


def page(shifts: list[Row], waves: list[Row], pairs: int, facts: dict[str, str | int]) -> str:
    """results.md."""
    machine = ", ".join(f"{key} {value}" for key, value in facts.items())
    disjoint = int(np.prod([n // WINDOW for n in SHIFT_SHAPE]))
    average = three(tuple(np.sinc(1 / w) for w in WAVELENGTHS), 2)
    return f"""# Correlation alone

Gaussian particles of sigma {SIGMA:g} voxel, on average {PARTICLES_A_WINDOW} to a window of {WINDOW}^3 voxels,
brightness log-normal ({BRIGHTNESS_SPREAD}); particles beyond the volumes' faces exist and move in. Windows overlap by
{100 * SETTINGS.overlap:.0f} %; no sub-windows; all other settings are the defaults but where named. Lengths in
voxels. Gross: an error above {GROSS_VOXELS:g} voxels on any axis, or no peak; the other figures leave these out. Inner:
without the outermost layer of windows. One thread each. Made by `run.py` beside this file; `results.json` holds every
figure.

Machine: {machine}.

## Uniform shifts

{pairs} pairs of volumes of {" x ".join(map(str, SHIFT_SHAPE[::-1]))} voxels, each with a shift drawn from
[-{LARGEST_SHIFT:g}, {LARGEST_SHIFT:g}] on every axis. Bias: mean error of the worst pair on each axis; a pair has
{disjoint} windows that do not overlap, so the standard error of a pair's mean is about RMS / {disjoint**0.5:.0f}.
Toward zero: mean of -error x sign(shift). Aims: bias <= {BIAS_AIM}, RMS <= {RMS_AIM} on every axis.

{shift_table(shifts)}

## Sinusoidal shear

Displacement along x, {WAVE_AMPLITUDE} voxels times a sine along y. Response: measured over true displacement; a plain
average over the window would give {average} at {", ".join(map(str, WAVELENGTHS))} windows.

{wave_table(waves)}
"""


def processor() -> str:
    """As the system names it, where it does."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.machine()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--pairs", type=int, default=12, help="pairs of volumes with a uniform shift; waves have a third"
    )
    parser.add_argument("--no-peer", action="store_true", help="leave OpenPIV out")
    parser.add_argument("--out", type=Path, default=HERE, metavar="DIR", help="where results.md and results.json go")
    arguments = parser.parse_args()

    methods: list[Method] = [single_pass, all_passes, against_ghosts]
    facts: dict[str, str | int] = {"processor": processor(), "cores": os.cpu_count() or 0}
    facts["Python"] = platform.python_version()
    facts |= {name: version(name) for name in ("plenopiv", "numpy", "scipy", "numba")}
    with tempfile.TemporaryDirectory() as folder:
        if not arguments.no_peer:
            peer = OpenPIV(Path(folder))
            methods.append(peer)
            facts["openpiv"] = peer.version
        pair, _ = next(shift_pairs(1, 0.0, 0.0))
        for method in methods:
            method(tuple(np.ascontiguousarray(v[:48, :64, :64]) for v in pair))  # compilation is not correlation
        shifts, waves = [], []
        for condition, disturbance in DISTURBANCES.items():
            shifts += scored(condition, methods, shift_pairs(arguments.pairs, *disturbance))
        for windows in WAVELENGTHS:
            waves += scored(str(windows), methods, wave_pairs(max(1, arguments.pairs // 3), windows))
    text = page(shifts, waves, arguments.pairs, facts)
    print(text)
    (arguments.out / "results.md").write_text(text)
    rows = {"uniform_shifts": [asdict(r) for r in shifts], "sinusoidal_shear": [asdict(r) for r in waves]}
    whole = {"machine": facts, "settings": asdict(SETTINGS), "pairs": arguments.pairs} | rows
    (arguments.out / "results.json").write_text(json.dumps(whole, indent=1) + "\n")


if __name__ == "__main__":
    main()
