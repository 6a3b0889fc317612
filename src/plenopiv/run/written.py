"""What a run leaves in its results folder when all pairs are measured: velocity.nc, summary, report."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

import plenopiv
from plenopiv.displacement.resolution import effective_window
from plenopiv.errors import printable, told_of
from plenopiv.experiment import Experiment
from plenopiv.io.netcdf import read_velocity
from plenopiv.io.output import plain
from plenopiv.io.series_file import write_series
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.recording import Recording
from plenopiv.report import series_of_file, write_report
from plenopiv.run.judged import Judgement
from plenopiv.run.log import Clock
from plenopiv.run.plan import Plan
from plenopiv.run.shown import FirstFrame
from plenopiv.run.versions import versions

if TYPE_CHECKING:
    import xarray

Score = Callable[["xarray.Dataset"], Mapping[str, Any]]
Record = Mapping[str, Any]  # of a pair, as the manifest has it (``PairRecord``)


def source(experiment: Experiment) -> str:
    """What fields say that they come from: an attribute, which HDF5 takes as UTF-8 alone."""
    return f"PlenoPIV {plenopiv.__version__}, {printable(experiment.path.name)}"


def summary_of(
    experiment: Experiment,
    recording: Recording,
    records: Sequence[Record],
    calibration: Mapping[str, Any],
    judgement: Judgement,
    plan: Plan,
    warned: Sequence[str],
    clock: Clock,
) -> dict[str, Any]:
    """What ``summary.json`` holds; ``records`` of all pairs."""
    fields = [record["numbers"] for record in records if record["set_aside"] is None]
    frames = {name: found for record in records for name, found in record["summaries"].items()}
    vectors = sum(field["vectors"] for field in fields)
    inside = [field["inside_body"] for field in fields if field["inside_body"] is not None]
    return {
        "not_in_images": not_in_images(fields, recording),
        "plenopiv": plenopiv.__version__,
        "versions": versions() | dict(plan.chain.device.versions),
        "device": plan.chain.device.stated,
        "experiment": experiment.path.name,
        "pairs": len(records),
        "frames": list(frames),
        **judgement.summary(records),
        "calibration": dict(calibration),
        "frame": plan.chain.frame,
        "voxels": plan.chain.grid.size,
        "effective_window_voxels": list(effective_window(plan.chain.correlation)),
        "reconstruction": frames,
        "vectors": vectors,
        **({"vectors_inside_body": sum(inside)} if inside else {}),
        "replaced_share": sum(field["replaced"] for field in fields) / max(vectors - sum(inside), 1),
        "median_peak_ratio": float(np.median([field["median_peak_ratio"] for field in fields])),
        "tiles": plan.tiles,
        "memory_estimate_gb": plan.needed.peak / 1e9,
        **({"device_memory_estimate_gb": plan.on_device / 1e9} if plan.on_device else {}),
        "warnings": list(warned),
        "time_estimate_s": round(plan.takes.run(len(frames), len(fields)), 1),
        **({} if plan.takes.speed is None else {"machine_speed": round(plan.takes.speed, 3)}),
        "timings_s": clock.seconds,
        "peak_memory_gb": clock.peak_gb,
    }


def not_in_images(fields: Sequence[Mapping[str, Any]], recording: Recording) -> dict[str, Any]:
    """What no image can tell, to be compared with what is known of the experiment: the largest displacement (voxels
    along x, y, z) and velocity (m/s), the time between pulses and the orientation that both rest on."""
    moved = np.max([field["largest_displacement_voxels"] for field in fields], axis=0)
    return {
        "largest_displacement_voxels": moved.tolist(),
        "largest_velocity_m_s": max(field["largest_velocity_m_s"] for field in fields),
        "dt_s": recording.dt_s,
        "orientation": recording.orientation,
    }


def write_results(
    folder: SeriesFolder,
    experiment: Experiment,
    times: Mapping[str, Sequence[float]],
    records: Sequence[Record],
    summary: dict[str, Any],
    first: FirstFrame,
    score: Score | None,
    clock: Clock,
) -> list[str]:
    """velocity.nc of a series, experiment.toml, report.html with its figures, and summary.json; returns their names.
    ``times``: "time" of each record in s, and what else the fields have of each time.

    Raises:
        PlenoPIVError: one cannot be written, or the file of a pair cannot be read.
    """
    files = {record["pair"]: _field_file(record) for record in records if record["set_aside"] is None}
    number = min(files)
    shown = read_velocity(folder.there(files[number]))
    names = ["experiment.toml", "report.html", "summary.json"]
    if len(records) > 1:
        there = {number: folder.there(name) for number, name in files.items()}
        attributes = {name: summary[name] for name in ("quality", "effective_window_voxels")}
        write_series(folder.path("velocity.nc"), shown, times, there, attributes)
        names.append("velocity.nc")
    with clock("report"), told_of(folder.path("report.html")):
        folder.write_text("experiment.toml", experiment.dump_toml(experiment.output_directory))
        write_report(
            folder.path("report.html"),
            title=f"{experiment.path.name}: velocity field",
            experiment=experiment,
            summary=summary,
            dataset=shown,
            crops=first.crops,
            views=first.views,
            stacks=first.stacks,
            series=series_of(times["time"], records) if len(times) == 1 else None,
            fields=series_of_file(folder.path("velocity.nc")) if len(records) > 1 else None,
            number=number,
            date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            figures_folder=folder.work / "figures",
            accuracy=score(_all_fields(folder, files)) if score else None,
        )
    folder.write_text("summary.json", json.dumps(plain(summary), indent=2, allow_nan=False) + "\n")
    figures = folder.work / "figures"
    return names + sorted(f"figures/{path.name}" for path in figures.iterdir()) if figures.is_dir() else names


def series_of(times_s: Sequence[float], records: Sequence[Record]) -> dict[str, Any]:
    """By pair what the report plots of a series: its time, share of vectors replaced, median ratio of peaks and
    largest velocity in m/s; NaN of a pair that was set aside."""
    none = {"vectors": 0, "inside_body": 0, "replaced": np.nan, "median_peak_ratio": np.nan}
    numbers = [record["numbers"] or {**none, "largest_velocity_m_s": np.nan} for record in records]
    counts = [max(each["vectors"] - (each["inside_body"] or 0), 1) for each in numbers]
    return {
        "time_s": list(times_s),
        "replaced_share": [each["replaced"] / count for each, count in zip(numbers, counts, strict=True)],
        "median_peak_ratio": [each["median_peak_ratio"] for each in numbers],
        "largest_velocity_m_s": [each["largest_velocity_m_s"] for each in numbers],
    }


def _field_file(record: Record) -> str:
    return next(name for name in record["files"] if name.endswith(".nc"))


def _all_fields(folder: SeriesFolder, files: Mapping[int, str]) -> xarray.Dataset:
    """The fields of all pairs, in memory."""
    import xarray

    fields = [read_velocity(folder.there(files[number])) for number in sorted(files)]
    return fields[0] if len(fields) == 1 else xarray.concat(fields, "time", combine_attrs="override")
