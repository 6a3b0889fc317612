"""What a run leaves in its results folder: vectors, summary, resolved experiment file, report, volumes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import plenopiv
from plenopiv.chain import Chain
from plenopiv.experiment import Experiment
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.output import OutputFolder
from plenopiv.io.vtkhdf import write_volume_vtkhdf
from plenopiv.lightfield import decode
from plenopiv.report import light_field_stacks, projections, raw_crops, volume_stack, write_report
from plenopiv.run.judged import Judgement
from plenopiv.run.log import Clock
from plenopiv.run.pair import Frame
from plenopiv.run.plan import Plan
from plenopiv.run.versions import versions
from plenopiv.velocity import replaced_share, vectors_inside_body

if TYPE_CHECKING:
    import xarray

Score = Callable[["xarray.Dataset"], Mapping[str, Any]]


@dataclass(frozen=True)
class FirstFrame:
    """What the report shows of the first frame: crops of its image, projections of its volume, and stacks of both."""

    crops: Any
    views: Any
    stacks: Any

    @classmethod
    def of(cls, chain: Chain, frame: Frame, clock: Clock) -> FirstFrame:
        """Of the first frame, while its volume is there."""
        camera, volume = chain.camera, frame.found.volume
        crops, views = raw_crops(frame.image, camera, frame.name), projections(volume)
        with clock("report"):
            light_field = decode(frame.image, chain.layout)
            stacks = [volume_stack(volume), *light_field_stacks(light_field, chain.grid.limits_mm()[2])]
        return cls(crops, views, stacks)


def write_volume(out: OutputFolder, frame: Frame) -> None:
    """The volume of a frame, for ParaView."""
    write_volume_vtkhdf(out.path(f"volume-{frame.source.stem}.vtkhdf"), frame.found.volume)


def joined(fields: Sequence[xarray.Dataset], experiment: Experiment, quality: str) -> xarray.Dataset:
    """The fields of successive pairs along time, where they come from, and what the checks say of the recording."""
    import xarray

    velocity = fields[0] if len(fields) == 1 else xarray.concat(fields, "time", combine_attrs="override")
    velocity.attrs["source"] = f"PlenoPIV {plenopiv.__version__}, {experiment.path.name}"
    velocity.attrs["quality"] = quality
    return velocity


def summary_of(
    experiment: Experiment,
    velocity: xarray.Dataset,
    frames: Mapping[str, Mapping[str, Any]],
    calibration: Mapping[str, Any],
    judgement: Judgement,
    plan: Plan,
    warned: Sequence[str],
    clock: Clock,
) -> dict[str, Any]:
    """What ``summary.json`` holds; ``frames``: of each by name (``Frame.summary``)."""
    return {
        "plenopiv": plenopiv.__version__,
        "versions": versions(),
        "experiment": experiment.path.name,
        "frames": list(frames),
        **judgement.summary(),
        "calibration": dict(calibration),
        "voxels": plan.chain.grid.size,
        "reconstruction": dict(frames),
        "vectors": int(velocity.valid.size),
        **({} if (inside := vectors_inside_body(velocity)) is None else {"vectors_inside_body": inside}),
        "replaced_share": replaced_share(velocity),
        "median_peak_ratio": float(np.nanmedian(velocity.peak_ratio.values)),
        "tiles": plan.tiles,
        "memory_estimate_gb": plan.needed.peak / 1e9,
        "warnings": list(warned),
        "time_estimate_s": round(plan.takes.run(len(frames), velocity.sizes["time"]), 1),
        "timings_s": clock.seconds,
        "peak_memory_gb": clock.peak_gb,
    }


def write_results(
    out: OutputFolder,
    experiment: Experiment,
    velocity: xarray.Dataset,
    summary: dict[str, Any],
    first: FirstFrame,
    score: Score | None,
    clock: Clock,
) -> None:
    """velocity.nc, experiment.toml, report.html with its figures, and summary.json."""
    with clock("report"):
        write_velocity(out.path("velocity.nc"), velocity)
        out.write_text("experiment.toml", experiment.dump_toml(experiment.output_directory))
        write_report(
            out.path("report.html"),
            title=f"{experiment.path.name}: velocity field",
            experiment=experiment,
            summary=summary,
            dataset=velocity,
            crops=first.crops,
            views=first.views,
            stacks=first.stacks,
            figures_folder=out.path("figures"),
            accuracy=score(velocity) if score else None,
        )
    out.write_json("summary.json", summary)
