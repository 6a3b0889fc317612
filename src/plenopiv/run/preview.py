"""A quick preview of the velocities: the middle of the field, coarsely, in well under a minute.

The sensor's middle is cut out of the white image and of two frames, the volume to what all views of it see, voxels are
twice as wide in the plane and windows half as many voxels, and there are fewer iterations. What follows is
``run.series`` on an experiment of its own, which stays beside the result with its images: a small recording to try
settings on.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from plenopiv.cameras.coverage import pixels_that_see, seen_by_every_view_mm
from plenopiv.design.advice import Limits, Window
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.report.figures import png, velocity_figure
from plenopiv.run.pair import Progress
from plenopiv.run.series import RunResult, run
from plenopiv.sensor import Sensor, middle, middle_of
from plenopiv.volume import VoxelGrid

WIDER = 2.0  # voxels in the plane
WINDOWS_ACROSS = 3.0  # last windows along x and y, as the experiment has them
ITERATIONS, FINE_PASSES = 3, 2
SMALLEST = 8  # voxels of a window's side
FOLDER, IMAGES = "preview", "images"
HELD = {"velocity.nc", "preview.png", "summary.json", "report.html", "experiment.toml", IMAGES}


def preview(experiment: Experiment, progress: Progress | None = None) -> RunResult:
    """Run the middle of a recording coarsely into the folder ``preview`` beside the experiment file.

    Written are velocity.nc, preview.png, summary.json, report.html, experiment.toml and the images that all was made
    of; an earlier preview is replaced when this one is whole. The experiment's results are not touched.

    Raises:
        PlenoPIVError: an input cannot be used, the volume leaves out the optical axis, or the folder ``preview`` is the
            results folder or holds something else.
    """
    folder = experiment.folder / FOLDER
    strange = {path.name for path in folder.iterdir()} - HELD if folder.is_dir() else set()
    if strange or folder.resolve() == experiment.output_directory.resolve():
        raise PlenoPIVError(f"{folder}: holds something else than a preview; move it, or rename output.directory")
    recording = experiment.recording()
    part, tables = cropped(experiment)
    stage = Path(tempfile.mkdtemp(prefix=".preview-", dir=experiment.folder))
    try:
        images = stage / IMAGES
        images.mkdir()
        pictures = {"a.tif": recording.frame(0), "b.tif": recording.frame(1), "white.tif": recording.white()}
        for name, counts in pictures.items():
            if counts is not None:
                tifffile.imwrite(images / name, np.ascontiguousarray(middle_of(counts, part)))
        result = run(Experiment.from_dict(tables, images / "experiment.toml"), progress)
        (stage / "preview.png").write_bytes(png(velocity_figure(result.velocity)))
        stage.chmod(0o755)  # a temporary folder is its owner's alone
        shutil.rmtree(folder, ignore_errors=True)
        os.replace(stage, folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return replace(result, directory=folder)


def cropped(experiment: Experiment) -> tuple[Sensor, dict[str, Any]]:
    """The part of the sensor that a preview uses, and its experiment's tables, whose paths start from the images.

    Raises:
        PlenoPIVError: the volume leaves out the optical axis or is too small for a window.
    """
    camera, volume = experiment.camera(), experiment.volume
    last = experiment.correlation.windows[-1]
    sides = [WINDOWS_ACROSS * n * d for n, d in zip(last[:2], volume.voxel_mm[:2], strict=True)]
    wanted = [
        (max(lo, -side / 2), min(hi, side / 2))
        for side, (lo, hi) in zip(sides, (volume.x_mm, volume.y_mm), strict=True)
    ]
    if any(not lo < 0 < hi for lo, hi in wanted):
        raise PlenoPIVError(f"{experiment.path}: volume leaves out the optical axis, where a preview is taken")
    half_x, half_y = (max(-lo, hi) for lo, hi in wanted)
    part = middle(camera.sensor, *pixels_that_see(camera, (half_x, half_y), volume.z_mm))
    seen = seen_by_every_view_mm(replace(camera, sensor=part), volume.z_mm)
    limits = [
        (max(lo, -float(reach.min())), min(hi, float(reach.min())))
        for (lo, hi), reach in zip(wanted, seen, strict=True)
    ]
    voxel = (WIDER * volume.voxel_mm[0], WIDER * volume.voxel_mm[1], volume.voxel_mm[2])
    if any(hi - lo < SMALLEST * d for (lo, hi), d in zip(limits, voxel[:2], strict=True)):
        raise PlenoPIVError(
            f"{experiment.path}: all views together see too little of the volume's middle for a preview"
        )
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["camera"]["sensor"] |= {"columns": part.columns, "rows": part.rows}
    tables["recording"] |= {"frames": ["a.tif", "b.tif"], "orientation": "upright"}
    if "white" in tables["recording"]:
        tables["recording"]["white"] = "white.tif"
    tables["volume"] |= {"x_mm": list(limits[0]), "y_mm": list(limits[1]), "voxel_mm": list(voxel)}
    tables["reconstruction"]["iterations"] = min(ITERATIONS, experiment.reconstruction.iterations)
    tables["correlation"]["windows"] = _windows(
        experiment.correlation.windows, (limits[0], limits[1], volume.z_mm), voxel
    )
    tables["correlation"].pop("inner_window", None)
    tables["correlation"]["fine_passes"] = min(FINE_PASSES, experiment.correlation.fine_passes)
    tables["output"]["directory"] = ".."
    tables.pop("simulation", None)
    return part, tables


def _windows(windows: Sequence[Window], limits: Limits, voxel_mm: tuple[float, float, float]) -> list[list[int]]:
    """The same windows in mm as far as they fit, in the wider voxels."""
    nz, ny, nx = VoxelGrid.covering(*limits, voxel_mm).shape
    return [
        [
            min(max(SMALLEST, round(side / wider)), count)
            for side, wider, count in zip(w, (WIDER, WIDER, 1), (nx, ny, nz), strict=True)
        ]
        for w in windows
    ]
