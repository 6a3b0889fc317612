"""A quick preview of the velocities: the middle of the field, coarsely, in well under a minute.

The sensor's middle is cut out of the white image and of two frames, the volume to what all views of it see, voxels are
twice as wide in the plane and windows half as many voxels, and there are fewer iterations. What follows is
``run.series`` on an experiment of its own, which stays beside the result with its images: a small recording to try
settings on.
"""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from plenopiv.body import read_body
from plenopiv.cameras.coverage import pixels_that_see, seen_by_every_view_mm
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.design.advice import Limits, Window
from plenopiv.device.backend import device_of
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning, told_of
from plenopiv.experiment import Experiment
from plenopiv.io.into_place import files_of
from plenopiv.io.manifest import NAME as MANIFEST
from plenopiv.io.manifest import Manifest, hash_of
from plenopiv.io.output import made_stage, sweep_stages
from plenopiv.recording import Recording
from plenopiv.report.figures import png, velocity_figure
from plenopiv.run import space as of_experiment
from plenopiv.run.frame import Progress
from plenopiv.run.series import RunResult, run
from plenopiv.run.solid import solid_in
from plenopiv.run.target import target_calibration
from plenopiv.sensor import Sensor, middle, middle_of
from plenopiv.volume import VoxelGrid

WIDER = 2.0  # voxels in the plane
WINDOWS_ACROSS = 3.0  # last windows along x and y, as the experiment has them
ITERATIONS, FINE_PASSES = 3, 2
SMALLEST = 8  # voxels of a window's side
FOLDER, IMAGES, STAGE, EXPERIMENT = "preview", "images", ".preview-", "experiment.toml"
PICTURE = "preview.png"


def preview(experiment: Experiment, progress: Progress | None = None) -> RunResult:
    """Run the middle of a recording coarsely into the folder ``preview`` beside the experiment file.

    Written are velocity.nc, preview.png, summary.json, report.html, experiment.toml and the images that all was made
    of; an earlier preview is replaced when this one is whole. The experiment's results are not touched.

    Raises:
        PlenoPIVError: an input or the device cannot be used, the volume leaves out the optical axis, or the folder
            ``preview`` is the results folder, holds something else, or an experiment file that was changed.
    """
    folder = experiment.folder / FOLDER
    if folder.resolve() == experiment.output_directory.resolve():
        raise PlenoPIVError(f"{folder}: is the results folder, and a preview goes there; rename output.directory")
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise PlenoPIVError(f"{folder}: is no folder but a {'link' if folder.is_symlink() else 'file'}; move it away")
    if strange := not_of_a_preview(folder):
        raise PlenoPIVError(f"{folder}: holds something else than a preview ({', '.join(strange[:3])}); move it")
    if changed_since(folder):
        raise PlenoPIVError(
            f"{folder / EXPERIMENT}: was changed, and a preview would replace it; copy the folder, or remove the file"
        )
    device_of(experiment.compute.device, experiment.compute.device_memory_gb)  # now: before images are read
    recording = experiment.recording()
    target, space = target_calibration(experiment, recording), of_experiment.space_of(experiment, recording)
    part, tables = cropped(experiment, space)
    if target is not None:
        target = replace(target, camera=replace(target.camera, sensor=part))
    sweep_stages(experiment.folder, STAGE)
    stage, lock = made_stage(experiment.folder, STAGE)
    try:
        images = stage / IMAGES
        images.mkdir()
        pictures, named = _pictures(recording, part)
        for name, picture in pictures.items():
            with told_of(folder / IMAGES / name):
                tifffile.imwrite(images / name, np.ascontiguousarray(picture))
        drift = experiment.recording_table.drift
        tables["recording"] = named | {"dt_s": recording.dt_s, "orientation": "upright", "drift": drift}
        _take_body(experiment, tables, images)
        _take_target(tables)
        result = run(
            Experiment.from_dict(tables, images / "experiment.toml"), progress, force=True, space=space, target=target
        )
        with told_of(folder / PICTURE):
            (stage / PICTURE).write_bytes(png(velocity_figure(result.velocity)))
        stage.chmod(0o755)  # a temporary folder is its owner's alone
        shutil.rmtree(folder, ignore_errors=True)
        lock.__exit__()
        lock.path.unlink()
        with told_of(folder):
            os.replace(stage, folder)
    finally:
        lock.__exit__()
        shutil.rmtree(stage, ignore_errors=True)
    return replace(result, directory=folder)


def changed_since(folder: Path) -> bool:
    """Whether the experiment file of a preview is another one than the preview wrote."""
    made, path = Manifest.read(folder / MANIFEST), folder / EXPERIMENT
    return made is not None and EXPERIMENT in made.files and path.exists() and hash_of(path) != made.files[EXPERIMENT]


def not_of_a_preview(folder: Path) -> list[str]:
    """Names of what ``folder`` holds that no preview wrote: the manifest of its run names what the run did."""
    if not folder.is_dir():
        return []
    written = files_of(Manifest.read(folder / MANIFEST) or Manifest())
    known = {IMAGES, PICTURE, MANIFEST, *(name.split("/")[0] for name in written)}
    return sorted({path.name for path in folder.iterdir()} - known)


def _pictures(recording: Recording, part: Sensor) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """The middle of the images of a recording's first pair and of those that calibrate it, upright, by the names of
    their files; and these names as [recording] has them."""
    first, second = recording.pairs[0]
    whole: dict[str, NDArray] = {"a.tif": recording.frame(first), "b.tif": recording.frame(second)}
    named: dict[str, Any] = {"frames": ["a.tif", "b.tif"]} if recording.is_sequence else {"pairs": [["a.tif", "b.tif"]]}
    if (white := recording.white()) is not None:
        whole["white.tif"], named["white"] = white, "white.tif"
    if (dark := recording.dark()) is not None:
        whole["dark.tif"], named["dark"] = dark, "dark.tif"
    if backgrounds := recording.backgrounds():
        files = [f"background-{number}.tif" for number in range(1, len(backgrounds) + 1)]
        whole |= dict(zip(files, backgrounds, strict=True))
        named["background"] = files
    if recording.background_of_frames:
        warnings.warn(
            'recording.background = "minimum": a preview reads one pair, and leaves static light in it',
            PlenoPIVWarning,
            stacklevel=3,
        )
    if recording.masked is not None and middle_of(recording.masked, part).any():
        whole["mask.tif"], named["mask"] = np.where(recording.masked, np.uint8(0), np.uint8(255)), "mask.tif"
    return {name: middle_of(image, part) for name, image in whole.items()}, named


def _take_body(experiment: Experiment, tables: dict[str, Any], folder: Path) -> None:
    """The file of the body into a preview's folder; none where the middle of the field lies outside the body."""
    if (name := tables["volume"].pop("body", None)) is None:
        return
    path, small = experiment.folder / name, Experiment.from_dict(tables)
    if solid_in(read_body(path), small.grid(), small.correlation.settings()).inside.any():
        shutil.copyfile(path, folder / "body.stl")
        tables["volume"]["body"] = "body.stl"


def _take_target(tables: dict[str, Any]) -> None:
    """Name the images of a target, which stay where they are, from the folder of a preview's images."""
    for plane in tables.get("calibration", {}).get("planes", ()):
        plane["image"] = str(Path("..", "..", plane["image"]))


def cropped(experiment: Experiment, space: SpaceMap | None = None) -> tuple[Sensor, dict[str, Any]]:
    """The part of the sensor that a preview uses, and its experiment's tables, [recording] still that of all.
    ``space``: the volume is the laboratory's.

    Raises:
        PlenoPIVError: the volume leaves out the optical axis or is too small for a window.
    """
    camera, volume = experiment.camera(), experiment.volume
    whole = (volume.x_mm, volume.y_mm, volume.z_mm)
    depth = whole[2] if space is None else space.lens_limits(whole)[2]
    axis = (0.0, 0.0) if space is None else space.to_laboratory([0.0, 0.0, 0.5 * sum(depth)])[:2].tolist()
    last = experiment.correlation.windows[-1]
    sides = [WINDOWS_ACROSS * n * d for n, d in zip(last[:2], volume.voxel_mm[:2], strict=True)]
    wanted = [
        (max(lo, at - side / 2), min(hi, at + side / 2)) for side, at, (lo, hi) in zip(sides, axis, whole, strict=False)
    ]
    if any(not lo < at < hi for at, (lo, hi) in zip(axis, wanted, strict=True)):
        raise PlenoPIVError(f"{experiment.path}: volume leaves out the optical axis, where a preview is taken")
    across = wanted if space is None else space.lens_limits((wanted[0], wanted[1], whole[2]))[:2]
    half_x, half_y = (max(-lo, hi) for lo, hi in across)
    part = middle(camera.sensor, *pixels_that_see(camera, (half_x, half_y), depth))
    seen = seen_by_every_view_mm(replace(camera, sensor=part), depth)
    reach_x, reach_y = (float(reach.min()) for reach in seen)
    if space is None:
        limits = [(max(lo, -reach), min(hi, reach)) for (lo, hi), reach in zip(wanted, (reach_x, reach_y), strict=True)]
    else:
        share = min(max(reach_x, 0.0) / half_x, max(reach_y, 0.0) / half_y, 1.0)
        limits = [(at + share * (lo - at), at + share * (hi - at)) for at, (lo, hi) in zip(axis, wanted, strict=True)]
    voxel = (WIDER * volume.voxel_mm[0], WIDER * volume.voxel_mm[1], volume.voxel_mm[2])
    if any(hi - lo < SMALLEST * d for (lo, hi), d in zip(limits, voxel[:2], strict=True)):
        raise PlenoPIVError(
            f"{experiment.path}: all views together see too little of the volume's middle for a preview"
        )
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["camera"]["sensor"] |= {"columns": part.columns, "rows": part.rows, "alignment": "low"}
    tables["volume"] |= {"x_mm": list(limits[0]), "y_mm": list(limits[1]), "voxel_mm": list(voxel)}
    tables["reconstruction"]["motion_tracking"] = 0
    tables["reconstruction"]["iterations"] = min(ITERATIONS, experiment.reconstruction.iterations)
    tables["correlation"]["windows"] = _windows(
        experiment.correlation.windows, (limits[0], limits[1], volume.z_mm), voxel
    )
    tables["correlation"].pop("inner_window", None)
    tables["correlation"]["fine_passes"] = min(FINE_PASSES, experiment.correlation.fine_passes)
    tables["output"] |= {"directory": "..", "volumes": False}
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
