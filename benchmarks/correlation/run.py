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
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from volumes import BRIGHTNESS_SPREAD, PARTICLES_A_WINDOW, SIGMA, WINDOW, Flow, Shape, particle_pair

from plenopiv.accuracy.velocity import GROSS_VOXELS
from plenopiv.displacement.multigrid import correlation_pass, measure
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.windows import window_grid
from plenopiv.volume import DenseVolume, VoxelGrid

HERE = Path(__file__).parent
PEER = "openpiv==0.26.0"
PEER_ENVIRONMENT = HERE.parents[1] / "build" / "openpiv"
SETTINGS = CorrelationSettings(windows=((WINDOW,) * 3,))  # all else by default, as in `run`
STEP = round(WINDOW * (1 - SETTINGS.overlap))

SHIFT_SHAPE: Shape = (128, 160, 160)
LARGEST_SHIFT = 4.0  # voxels
DISTURBANCES = {"uniform shift": (0.0, 0.0), "uniform shift, 30 % lost, 30 % ghosts": (0.3, 0.3)}
WAVE_SHAPE: Shape = (64, 384, 96)
WAVE_AMPLITUDE = 1.5  # voxels
WAVELENGTHS = (2, 3, 4)  # windows
BIAS_AIM, RMS_AIM = 0.01, 0.03  # voxel, uniform shift

Pair = tuple[NDArray, NDArray]
Method = Callable[[Pair], tuple[NDArray, float]]  # displacements (3, nz, ny, nx) and CPU-seconds


def single_pass(pair: Pair) -> tuple[NDArray, float]:
    """The first pass of `run`: volumes as they are."""
    a, b = dense(pair)
    begin = time.process_time()
    found = correlation_pass(a, b, window_grid(a.grid.shape, (WINDOW,) * 3, SETTINGS.overlap), None, SETTINGS, 0.375)
    return np.where(found.found, found.displacement, np.nan), time.process_time() - begin


def all_passes(pair: Pair) -> tuple[NDArray, float]:
    """All passes of `run`, before the last validation."""
    a, b = dense(pair)
    begin = time.process_time()
    field = measure(a, b, SETTINGS)
    return field.raw, time.process_time() - begin


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

    def __call__(self, pair: Pair) -> tuple[NDArray, float]:
        for name, values in zip("ab", pair, strict=True):
            np.save(self.folder / f"{name}.npy", values)
        print(self.folder, file=self.process.stdin, flush=True)
        seconds = float(self._line())
        return np.load(self.folder / "d.npy"), seconds

    def _line(self) -> str:
        line = self.process.stdout.readline().strip()
        if not line:
            raise SystemExit("OpenPIV's process ended; what it said stands above")
        return line


@dataclass
class Row:
    """One method under one condition; lengths in voxels, components x, y, z.

    ``bias``: mean error of the worst pair along each axis: over all pairs a pull toward zero would cancel.
    ``rms``: of the error. ``gross``: share of windows with an error above ``GROSS_VOXELS``, or no peak; both figures
    leave them out. ``toward_zero``: mean of -error * sign(shift). ``response``: measured over true amplitude of a wave.
    """

    condition: str
    method: str
    pairs: int
    vectors: int
    gross: float
    rms: tuple[float, ...]
    vectors_a_cpu_s: float
    bias: tuple[float, ...] | None = None
    toward_zero: tuple[float, ...] | None = None
    response: float | None = None
    noise: tuple[float, ...] | None = None


def shift_pairs(count: int, lost: float, ghosts: float) -> Iterator[tuple[Pair, Flow]]:
    for number in range(count):
        rng = np.random.default_rng([1, number])
        shift = rng.uniform(-LARGEST_SHIFT, LARGEST_SHIFT, 3)

        def flow(p: NDArray, shift: NDArray = shift) -> NDArray:
            return np.broadcast_to(shift, p.shape)

        yield particle_pair(SHIFT_SHAPE, flow, rng, lost, ghosts), flow


def wave_pairs(count: int, windows: int) -> Iterator[tuple[Pair, Flow]]:
    """Displacement along x that varies as a sine along y."""
    for number in range(count):
        rng = np.random.default_rng([2, windows, number])
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


def triple(values: NDArray) -> tuple[float, ...]:
    return tuple(round(float(v), 5) for v in values)


def scored(condition: str, methods: dict[str, Method], pairs: Iterator[tuple[Pair, Flow]], wave: bool) -> list[Row]:
    """One row a method; every pair is measured by all methods before the next one is made."""
    truths, found, seconds = [], {name: [] for name in methods}, dict.fromkeys(methods, 0.0)
    for pair, flow in pairs:
        truths.append(at_centres(flow, pair[0].shape))
        for name, method in methods.items():
            displacement, spent = method(pair)
            found[name].append(displacement)
            seconds[name] += spent
    truth = np.stack(truths)
    return [row(condition, name, np.stack(found[name]), truth, seconds[name], wave) for name in methods]


def row(condition: str, method: str, found: NDArray, truth: NDArray, seconds: float, wave: bool) -> Row:
    """``found``, ``truth``: (pair, component, nz, ny, nx)."""
    error = found - truth
    fine = (np.abs(error) <= GROSS_VOXELS).all(1, keepdims=True)  # NaN is not
    counted = np.broadcast_to(fine, error.shape)
    rest, windows = (0, 2, 3, 4), (2, 3, 4)
    vectors = fine.size
    rms = np.sqrt(np.mean(error**2, rest, where=counted))
    out = Row(condition, method, len(found), vectors, 1 - fine.mean(), triple(rms), round(vectors / seconds, 1))
    if wave:
        x, t = found[:, 0][fine[:, 0]], truth[:, 0][fine[:, 0]]
        out.response = round(float((x * t).sum() / (t * t).sum()), 4)
        left = np.where(fine, found - out.response * truth, 0.0)
        out.noise = triple(np.sqrt(np.mean(left**2, rest, where=counted)))
    else:
        mean = np.mean(error, windows, where=counted)
        out.bias = triple(np.abs(mean).max(0))
        out.toward_zero = triple(-np.mean(error * np.sign(truth), rest, where=counted))
    return out


def tables(rows: list[Row], facts: dict[str, str | int]) -> str:
    """Markdown."""

    def three(values: tuple[float, ...], digits: int = 3) -> str:
        return " / ".join(f"{v:.{digits}f}" for v in values)

    shifts = [
        "| volumes | method | windows | gross % | bias x / y / z | toward zero x / y / z | RMS x / y / z | aims | vectors a CPU-s |",
        "|---|---|---:|---:|---:|---:|---:|---|---:|",
    ]
    waves = [
        "| wavelength, windows | method | windows | gross % | response | RMS x / y / z | RMS about the response | vectors a CPU-s |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for r in rows:
        gross = f"{100 * r.gross:.2f}"
        if r.response is None:
            met = max(r.bias) <= BIAS_AIM, max(r.rms) <= RMS_AIM
            aims = "both met" if all(met) else " and ".join(n for n, m in zip(("bias", "RMS"), met) if not m) + " missed"
            cells = [r.condition, r.method, r.vectors, gross, three(r.bias, 4), three(r.toward_zero, 4), three(r.rms, 4)]
            shifts.append("| " + " | ".join(map(str, [*cells, aims, f"{r.vectors_a_cpu_s:.0f}"])) + " |")
        else:
            cells = [r.condition, r.method, r.vectors, gross, f"{r.response:.3f}", three(r.rms), three(r.noise)]
            waves.append("| " + " | ".join(map(str, [*cells, f"{r.vectors_a_cpu_s:.0f}"])) + " |")
    machine = ", ".join(f"{key} {value}" for key, value in facts.items())
    shift_pairs_made = next(r.pairs for r in rows if r.response is None)
    return f"""# Correlation alone

Gaussian particles of sigma {SIGMA:g} voxel, {PARTICLES_A_WINDOW} to a window of {WINDOW} x {WINDOW} x {WINDOW} voxels, \
brightness log-normal ({BRIGHTNESS_SPREAD}), {100 * SETTINGS.overlap:.0f} % overlap. Lengths in voxels. Gross: an error
above {GROSS_VOXELS:g} voxels on any axis, or no peak; other figures leave these out. Settings are the defaults. One
thread each. Made by `run.py` beside this file; every figure is in `results.json`.

Machine: {machine}.

## Uniform shifts

{shift_pairs_made} pairs of volumes, each with a shift drawn from [-{LARGEST_SHIFT:g}, {LARGEST_SHIFT:g}] on every axis. \
Bias: mean error of the worst pair on each axis. Toward zero: mean of
-error x sign(shift). Aims: bias <= {BIAS_AIM}, RMS <= {RMS_AIM} on every axis.

{chr(10).join(shifts)}

## Sinusoidal shear

Displacement along x, {WAVE_AMPLITUDE} voxels times a sine along y. Response: measured over true amplitude; a plain \
average over the window would give {three(tuple(np.sinc(1 / w) for w in WAVELENGTHS), 2)}.

{chr(10).join(waves)}
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
    parser.add_argument("--pairs", type=int, default=12, help="pairs of volumes with a uniform shift; waves have a third")
    parser.add_argument("--no-peer", action="store_true", help="leave OpenPIV out")
    parser.add_argument("--out", type=Path, default=HERE, metavar="DIR", help="where results.md and results.json go")
    arguments = parser.parse_args()

    passes = SETTINGS.fine_passes
    methods: dict[str, Method] = {"PlenoPIV, one pass": single_pass, f"PlenoPIV, {passes} passes": all_passes}
    facts: dict[str, str | int] = {"processor": processor(), "cores": os.cpu_count() or 0}
    facts["Python"] = platform.python_version()
    facts |= {name: version(name) for name in ("plenopiv", "numpy", "scipy", "numba")}
    with tempfile.TemporaryDirectory() as folder:
        if not arguments.no_peer:
            peer = OpenPIV(Path(folder))
            methods["OpenPIV"] = peer
            facts["openpiv"] = peer.version
        warm_up, _ = next(shift_pairs(1, 0.0, 0.0))
        all_passes(tuple(v[:48, :64, :64] for v in warm_up))  # compilation is not correlation
        rows = []
        for condition, disturbance in DISTURBANCES.items():
            rows += scored(condition, methods, shift_pairs(arguments.pairs, *disturbance), wave=False)
        for windows in WAVELENGTHS:
            rows += scored(str(windows), methods, wave_pairs(max(1, arguments.pairs // 3), windows), wave=True)
    page = tables(rows, facts)
    print(page)
    (arguments.out / "results.md").write_text(page)
    lines = {"machine": facts, "settings": asdict(SETTINGS), "rows": [asdict(r) for r in rows]}
    (arguments.out / "results.json").write_text(json.dumps(lines, indent=1) + "\n")


if __name__ == "__main__":
    main()
