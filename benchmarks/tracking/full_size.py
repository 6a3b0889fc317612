"""What tracking a pair of the paper's full size takes, and parts of it, with one thread and with two: full_size.json.

    .venv/bin/python benchmarks/tracking/full_size.py [case ...]

Recordings as ``full`` of benchmarks/accuracy/conditions.py (PMR 14, M = -1, 1 particle per microlens, 20 mm deep), but
their light is that of exact areas, which the fit knows: rays enough that their own noise is no light of particles would
take an hour. Errors are therefore a little smaller than in ``particles.py``, whose light is independent. Parts are a
half and a quarter of the sensor and the volume along x and y. They are kept in build/full_size. Each case is one run of
``track`` in a process of its own, from images to tracks and field. Seconds are those that passed and those of the
processor; memory is the process' largest. Particles are judged as in ``jet.py``. Results of one and of two threads are
compared bit by bit: ``sha256`` is of all numbers of tracks.nc and velocity.nc.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from recorded import run_cases, three, write_table
from tracks_judged import judged

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.run import track_frame, track_pair
from plenopiv.run.memory import peak_so_far
from plenopiv.run.track import track
from plenopiv.simulation import simulated_recording
from plenopiv.simulation.particles import Particles
from plenopiv.tracking.light import PointLights
from plenopiv.tracking.refine import image_of

sys.path.append(str(Path(__file__).parents[1] / "accuracy"))
from conditions import CONDITIONS, DT_S

RECORD = Path(__file__).with_name("full_size.json")
KEPT = Path(__file__).parents[2] / "build" / "full_size"
PARTS = {"a sixteenth": 4, "a quarter": 2, "full": 1}  # of the sensor; the divisor along x and y
CASES = {f"{part}, {n} thread{'s' * (n > 1)}": {"part": part, "threads": n} for part in PARTS for n in (2, 1)}
del CASES["full, 1 thread"]  # three hours, for what the quarter tells
STAGES = {  # what the stages of a run are done by
    "reconstruction": ((Chain, "reconstruct"),),
    "correlation": ((Chain, "displacement"),),
    "first frame": ((track_frame, "particles_of_frame"),),
    "second frame": ((track_frame, "particles_of_second_frame"),),
    "links and field": ((track_pair, "linked"), (track_pair, "velocity_of_tracks")),
}
TRACKING = ("first frame", "second frame", "links and field")  # beyond what ``plenopiv run`` does


def measure(part: str, threads: int) -> dict[str, Any]:
    """One case, its recording made where it is not there."""
    folder = KEPT / part.removeprefix("a ")
    _simulated(folder, PARTS[part])
    os.environ["NUMBA_NUM_THREADS"] = str(threads)  # of the new process
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_tracked, folder).result()


def _simulated(folder: Path, divisor: int) -> None:
    """Write a recording into ``folder``."""
    if (folder / "truth.json").exists():
        return
    full = CONDITIONS["full"]
    one = replace(
        full,
        columns=full.columns // divisor,
        rows=full.rows // divisor,
        x_mm=full.x_mm / divisor,
        y_mm=full.y_mm / divisor,
    )
    simulated_recording.particle_image = _exact
    simulated_recording.simulate_recording(
        folder, one.camera(), one.flow(), dt_s=DT_S, volume_mm=one.volume_mm(), voxel_mm=one.voxel_mm(),
        windows=one.windows, seed=one.seed, overwrite=True,
    )  # fmt: skip


def _exact(camera: PlenopticCamera, particles: Particles, **of_rays: Any) -> NDArray[np.float64]:
    """An image (rows, columns) in electrons of the light of ``particles``, without rays."""
    shape = camera.sensor.rows, camera.sensor.columns
    light = image_of(PointLights(camera), particles.position_mm, particles.electrons, shape[0] * shape[1])
    return light.reshape(shape)


def _tracked(folder: Path) -> dict[str, Any]:
    """Track one recording: time by stage, memory, and what was found."""
    passed, processor, peaks = dict.fromkeys(STAGES, 0.0), dict.fromkeys(STAGES, 0.0), dict.fromkeys(STAGES, 0.0)
    for stage, places in STAGES.items():
        for owner, name in places:
            setattr(owner, name, _timed(getattr(owner, name), stage, passed, processor, peaks))
    with tempfile.TemporaryDirectory(dir=folder) as out, warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        experiment = Experiment.load(folder / "experiment.toml").changed(directory=out)
        began, worked = time.perf_counter(), time.process_time()
        found = track(experiment)
        all_passed, all_worked = time.perf_counter() - began, time.process_time() - worked
        peak = peak_so_far()
        tracks, field = xarray.load_dataset(found.path), xarray.load_dataset(found.velocity)
    return {
        "particles": [int((tracks.frame == number).sum()) for number in (0, 1)],
        "passed_s": {stage: round(s, 1) for stage, s in (passed | {"all": all_passed}).items()},
        "processor_s": {stage: round(s, 1) for stage, s in (processor | {"all": all_worked}).items()},
        "peak_gb": None if peak is None else round(peak / 1e9, 2),
        "peak_gb_by_then": {stage: round(most / 1e9, 2) for stage, most in peaks.items()},
        "sha256": _digest(tracks, field),
        "judged": _judged(folder, experiment, tracks),
    }


def _timed(
    work: Callable, stage: str, passed: dict[str, float], processor: dict[str, float], peaks: dict[str, float]
) -> Callable:
    """``work`` with its seconds added to those of its stage, and the process' largest memory by then."""

    def run(*args: Any, **named: Any) -> Any:
        began, worked = time.perf_counter(), time.process_time()
        try:
            return work(*args, **named)
        finally:
            passed[stage] += time.perf_counter() - began
            processor[stage] += time.process_time() - worked
            peaks[stage] = peaks[stage] or peak_so_far() or 0.0

    return run


def _digest(*fields: xarray.Dataset) -> str:
    """Of all numbers."""
    sha = hashlib.sha256()
    for field in fields:
        for name in sorted(map(str, field.variables)):
            sha.update(name.encode() + np.ascontiguousarray(field[name].values).tobytes())
    return sha.hexdigest()[:16]


def _judged(folder: Path, experiment: Experiment, tracks: xarray.Dataset) -> dict[str, dict]:
    """Against the true particles."""
    camera = experiment.camera()
    with np.load(folder / "truth_particles.npz") as true:
        places = true["a"].astype(float), true["b"].astype(float)
    zone = 1.5 * camera.dead_zone_mm()[1]
    bands = {"inside": (0.0, zone), "beyond, to 6 mm": (zone, 6.0), "beyond 6 mm": (6.0, np.inf)}
    return judged(tracks, places, PointLights(camera), np.array(experiment.grid().voxel_mm), bands)


def page(record: dict) -> None:
    """Write the tables into docs/tracking.md."""
    made = {name: case.get("made_with") for name, case in json.loads(RECORD.read_text()).items()}
    lines = [
        f"| sensor | particles | threads | {' | '.join(STAGES)} | tracking together | ms a particle | GB |",
        f"|---|---:|---:|{'---:|' * (len(STAGES) + 3)}",
    ]
    for name, own in record.items():
        part, threads = name.rsplit(", ", 1)
        spent = {stage: (own["passed_s"][stage], own["processor_s"][stage]) for stage in STAGES}
        together = tuple(sum(spent[stage][k] for stage in TRACKING) for k in (0, 1))
        cells = [f"{passed:.0f} / {worked:.0f}" for passed, worked in (*spent.values(), together)]
        each = 1e3 * together[1] / sum(own["particles"])
        lines.append(
            f"| {part} | {own['particles'][0]:,} | {threads.split()[0]} | {' | '.join(cells)} | {each:.1f} | "
            f"{own['peak_gb']:.1f} |"
        )
    lines += ["", "| sensor | depth | n | found % | ghosts % | RMS x / y / z | linked % | wrong % | same bits |"]
    lines.append("|---|---|---:|---:|---:|---:|---:|---:|---|")
    for part in PARTS:
        of_part = [name for name in record if name.rsplit(", ", 1)[0] == part]
        runs = [record[name] for name in of_part]
        by_one_program = len(runs) > 1 and len({made.get(name) for name in of_part}) == 1
        same = "" if not by_one_program else "yes" if len({own["sha256"] for own in runs}) == 1 else "no"
        for band, one in (runs[0]["judged"] if runs else {}).items():
            shares = [f"{100 * one[key]:.1f}" for key in ("found", "ghosts")]
            links = [f"{100 * one[key]:.2f}" for key in ("linked", "wrong")]
            lines.append(
                f"| {part} | {band} | {one['n']:,} | {' | '.join(shares)} | {three(one['rms'])} | "
                f"{' | '.join(links)} | {same} |"
            )
    write_table("full-size", lines)


if __name__ == "__main__":
    run_cases(RECORD, CASES, {}, measure, page)
