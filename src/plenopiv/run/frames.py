"""All frames of a recording: light fields -> volumes -> displacements -> velocity -> results folder.

Frames are ``dt_s`` apart; each is reconstructed once and correlated with the one before it.
"""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numpy.typing import NDArray

import plenopiv
from plenopiv.calibration import find_lattice
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.displacement.multigrid import measure
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.output import OutputFolder
from plenopiv.io.vtkhdf import write_volume_vtkhdf
from plenopiv.lightfield import decode, layout
from plenopiv.projection.plenoptic.projector import Projector
from plenopiv.reconstruction.focus import focus_weight
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE, counts_per_electron
from plenopiv.reconstruction.reconstruct import Reconstruction
from plenopiv.reconstruction.tiles import cut, reconstruct_in_tiles
from plenopiv.recording import Recording
from plenopiv.report import light_field_stacks, projections, raw_crops, volume_stack, write_report
from plenopiv.run import duration, memory
from plenopiv.run.memory import peak_so_far, tiles_within
from plenopiv.run.versions import versions
from plenopiv.velocity import velocity_dataset

if TYPE_CHECKING:
    import xarray

log = logging.getLogger("plenopiv")
Progress = Callable[[str, int, int], None]
Score = Callable[["xarray.Dataset"], Mapping[str, Any]]


@dataclass(frozen=True)
class RunResult:
    """The velocity field, what ``summary.json`` holds, and where both are."""

    velocity: xarray.Dataset
    summary: dict[str, Any]
    directory: Path


def calibrated_camera(experiment: Experiment, recording: Recording) -> tuple[PlenopticCamera, dict[str, Any]]:
    """The camera with its lattice as the white image shows it, or as the file states it, and how well that fits."""
    camera, white = experiment.camera(), recording.white()
    if white is None:
        return camera, {"lattice": "as stated in the experiment file"}
    fit = find_lattice(white, camera, str(recording.white_path))
    return camera.with_lattice(fit.lattice), {
        "lattice": fit.lattice.kind,
        "pitch_mm": fit.lattice.pitch_mm,
        "rotation_deg": fit.rotation_deg,
        "offset_mm": fit.offset_mm,
        "residual_px": fit.residual_px,
        "microlenses": fit.microlenses,
    }


def run(
    experiment: Experiment,
    progress: Progress | None = None,
    overwrite: bool = False,
    score: Score | None = None,
    memory_gb: float | None = None,
) -> RunResult:
    """Run the whole chain and write the results folder: velocity.nc, summary.json, experiment.toml, report.html
    and its figures.

    ``progress(stage, done, total)`` is called as work proceeds. ``score``, where the truth is known, turns the velocity
    field into measures for the report; a run itself never reads a truth. ``memory_gb``: a run that would take more is
    cut into tiles, or does not begin where these would not help.

    Raises:
        PlenoPIVError: an input cannot be used, or memory does not suffice; the results folder is then as it was.
    """
    report = progress or (lambda stage, done, total: None)
    clock = _Clock()
    with _kept_warnings() as caught, OutputFolder(experiment.output_directory, overwrite) as out:
        for line in experiment.warnings():
            warnings.warn(line, PlenoPIVWarning, stacklevel=2)
        recording = experiment.recording()
        with clock("calibration"):
            camera, calibration = calibrated_camera(experiment, recording)
            where = layout(camera)
            projector = Projector(where, experiment.grid(), experiment.reconstruction.weights)
            white = recording.white()
            gain = NO_WHITE_IMAGE if white is None else counts_per_electron(decode(white, where))
            del white

        weight = focus_weight(camera, projector.grid.axes()[2], experiment.reconstruction.focus_reach)
        settings, correlation = experiment.reconstruction.settings(), experiment.correlation.settings()
        needed = memory.of_settings(camera, projector.grid, settings, correlation)
        for k in range(2):  # before long work begins; later frames when their turn comes
            recording.frame(k)
        rows = projector.grid.shape[1]
        tiles = cut(rows, 1, 0)
        if memory_gb is not None and needed.peak > 1e9 * memory_gb:
            tiles = tiles_within(needed, 1e9 * memory_gb, rows, projector.passage)
            largest = max(tile.high - tile.low for tile in tiles)
            log.info("the volume is reconstructed in %d tiles, the largest of %d of %d rows", len(tiles), largest, rows)
            needed = needed.in_tiles(largest / rows)
        log.info("memory: about %.2g GB", needed.peak / 1e9)
        takes = duration.of_settings(camera, projector.grid, settings, correlation, numba.get_num_threads())
        takes = replace(takes, frame=takes.frame * sum(tile.high - tile.low for tile in tiles) / rows)
        log.info("time: about %s", duration.spoken(takes.run(len(recording))))

        def reconstructed(k: int) -> tuple[NDArray[np.uint16], Reconstruction]:
            name = recording.frame_paths[k].name
            with clock("reconstruction"):
                image = recording.frame(k)
                found = reconstruct_in_tiles(
                    decode(image, where),
                    projector,
                    tiles,
                    settings,
                    counts_per_electron=gain,
                    name=name,
                    progress=partial(report, f"reconstruction of {name}"),
                )
            if experiment.output.volumes:
                with clock("report"):
                    stem = recording.frame_paths[k].stem
                    write_volume_vtkhdf(out.path(f"volume-{stem}.vtkhdf"), found.volume)
            return image, found

        image, before = reconstructed(0)
        left = takes.left(len(recording), clock.seconds["reconstruction"])
        log.info("%s reconstructed; about %s left", recording.frame_paths[0].name, duration.spoken(left))
        crops, views = raw_crops(image, camera, recording.frame_paths[0].name), projections(before.volume)
        with clock("report"):
            z_mm = projector.grid.limits_mm()[2]
            stacks = [volume_stack(before.volume), *light_field_stacks(decode(image, where), z_mm)]
        names = [path.name for path in recording.frame_paths]
        frames, fields = {names[0]: _frame_summary(before)}, []
        for k in range(1, len(recording)):
            _, after = reconstructed(k)
            frames[names[k]] = _frame_summary(after)
            with clock("correlation"):
                first, second = (found.volume.with_planes_scaled(weight) for found in (before, after))
                field = measure(first, second, correlation, report)
            dt_s = recording.dt_s
            fields.append(velocity_dataset(field, projector.grid, dt_s, time_s=(k - 0.5) * dt_s))
            before = after
        velocity = _joined(fields)
        velocity.attrs["source"] = f"PlenoPIV {plenopiv.__version__}, {experiment.path.name}"
        summary = {
            "plenopiv": plenopiv.__version__,
            "versions": versions(),
            "experiment": experiment.path.name,
            "frames": names,
            "calibration": calibration,
            "voxels": projector.grid.size,
            "reconstruction": frames,
            "vectors": int(velocity.valid.size),
            "replaced_share": float(1.0 - velocity.valid.values.mean()),
            "median_peak_ratio": float(np.nanmedian(velocity.peak_ratio.values)),
            "tiles": len(tiles),
            "memory_estimate_gb": needed.peak / 1e9,
            "warnings": [str(w.message) for w in caught],
            "time_estimate_s": round(takes.run(len(recording)), 1),
            "timings_s": clock.seconds,
            "peak_memory_gb": clock.peak_gb,
        }
        with clock("report"):
            write_velocity(out.path("velocity.nc"), velocity)
            out.write_text("experiment.toml", experiment.dump_toml(experiment.output_directory))
            write_report(
                out.path("report.html"),
                title=f"{experiment.path.name}: velocity field",
                experiment=experiment,
                summary=summary,
                dataset=velocity,
                crops=crops,
                views=views,
                stacks=stacks,
                figures_folder=out.path("figures"),
                accuracy=score(velocity) if score else None,
            )
        out.write_json("summary.json", summary)
    return RunResult(velocity, summary, experiment.output_directory)


def _frame_summary(frame: Reconstruction) -> dict[str, Any]:
    return {
        "dark_noise_counts": frame.noise.dark,
        "counts_per_electron": frame.noise.counts_per_electron,
        "typical_particle_counts": frame.particle,
        "threshold_counts": frame.threshold,
        "candidate_share": frame.candidates,
        "residual_counts_by_round": list(frame.residuals),
        "voxels_kept": int(frame.volume.column.size),
    }


def _joined(fields: list[xarray.Dataset]) -> xarray.Dataset:
    """The fields of successive pairs along time."""
    import xarray

    return fields[0] if len(fields) == 1 else xarray.concat(fields, "time", combine_attrs="override")


class _Clock:
    """Seconds of wall time by stage, and the peak of memory (GB) that the run had reached at its end."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.peak_gb: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str):
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin
            if (peak := peak_so_far()) is not None:
                self.peak_gb[stage] = round(peak / 1e9, 3)


@contextmanager
def _kept_warnings():
    """Collect warnings and still show them, each where and when it occurs."""
    caught: list[warnings.WarningMessage] = []
    show = warnings.showwarning
    with warnings.catch_warnings():
        warnings.simplefilter("always", PlenoPIVWarning)

        def keep(message, category, filename, lineno, file=None, line=None):
            if issubclass(category, PlenoPIVWarning) and str(message) not in [str(w.message) for w in caught]:
                caught.append(warnings.WarningMessage(message, category, filename, lineno, file, line))
                show(message, category, filename, lineno, file, line)

        warnings.showwarning = keep
        yield caught
