"""``plenopiv info``: what an experiment file, a file of results or an image holds, as plain text."""

from __future__ import annotations

import warnings
from math import prod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.displacement.windows import step_of
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning, printable
from plenopiv.experiment import Experiment
from plenopiv.io.beside import unfinished
from plenopiv.run import memory

Lines = list[tuple[str, str]]


def info(file: Path) -> str:
    """A few lines about a file.

    Raises:
        PlenoPIVError: the file is missing, damaged or of no kind that is known.
    """
    if file.is_dir():
        remedy = unfinished(file) or "name the experiment file, velocity.nc or the image in it"
        raise PlenoPIVError(f"{file}: is a folder; {remedy}")
    lines = {".toml": _experiment, ".nc": _results}.get(file.suffix.lower(), _image)(file)
    width = max(len(name) for name, _ in lines)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in lines)


def camera_lines(camera: PlenopticCamera) -> Lines:
    """The camera in the terms of the field."""
    lens, sensor, lattice = camera.main_lens, camera.sensor, camera.lattice
    near, far = camera.dead_zone_mm()
    return [
        (
            "main lens",
            f"f = {lens.focal_length_mm:g} mm, aperture {lens.aperture_mm:.4g} mm, M = {lens.magnification:g}; "
            f"S_o = {lens.object_distance_mm:.4g} mm, S_i = {lens.image_distance_mm:.4g} mm",
        ),
        (
            "microlenses",
            f"{lattice.kind}, pitch {1e3 * lattice.pitch_mm:.4g} um, f_l = "
            f"{1e3 * camera.microlens_focal_length_mm:.4g} um; "
            f"micro-images every {camera.image_pitch_px:.3f} px",
        ),
        (
            "sensor",
            f"{sensor.columns} x {sensor.rows} px of {1e3 * sensor.pixel_pitch_mm:g} um, {sensor.bit_depth} bits, "
            f"black level {sensor.black_level:g}",
        ),
        ("PMR", f"{camera.pixels_per_microlens:.2f} pixels per microlens"),
        (
            "f-numbers",
            f"main lens f/{lens.image_distance_mm / lens.aperture_mm:.3g} on the image side, microlenses "
            f"f/{camera.microlens_focal_length_mm / lattice.pitch_mm:.3g}; matched at an aperture of "
            f"{camera.matched_aperture_mm:.4g} mm",
        ),
        ("dead zone", f"z from {near:.3g} to {far:.3g} mm: there a point's depth may leave no trace"),
    ]


def _experiment(file: Path) -> Lines:
    experiment = Experiment.load(file)
    camera, grid = experiment.camera(), experiment.grid()
    lines = camera_lines(camera)
    lo, hi = experiment.volume.z_mm
    depths = sorted({lo, 0.0, hi}) if lo < 0 < hi else (lo, hi)
    for z in depths if experiment.calibration is None else ():  # else these are depths of a target
        x, y = (2 * max(float(side), 0.0) for side in seen_by_every_view_mm(camera, z))
        lines.append((f"field at z = {z:g}", f"{x:.4g} x {y:.4g} mm seen by every view"))
    nz, ny, nx = grid.shape
    sides = " x ".join(f"{1e3 * d:.4g}" for d in grid.voxel_mm)
    lines.append(("volume", f"{nx} x {ny} x {nz} = {grid.size / 1e6:.3g} million voxels of {sides} um"))
    needed = memory.of_settings(camera, grid, experiment.reconstruction.settings(), experiment.correlation.settings())
    lines.append(("memory", f"a run takes about {needed.peak / 1e9:.2g} GB"))
    windows = experiment.correlation.windows
    last = windows[-1]
    overlap = experiment.correlation.overlap
    spacing = [1e3 * d * step_of(n, overlap) for d, n in zip(grid.voxel_mm, last, strict=True)]
    lines.append(("windows", " -> ".join(" x ".join(map(str, window)) for window in windows) + " voxels"))
    sub_window = experiment.correlation.settings().sub_window
    if sub_window is not None:
        lines.append(
            ("sub-windows", f"{' x '.join(map(str, sub_window))} voxels; a vector is their mean over the last window")
        )
    lines.append(("vectors", "every " + " x ".join(f"{d:.3g}" for d in spacing) + " um"))
    table = experiment.recording_table
    try:
        lines.append(("frames", f"{len(experiment.recording())}, {table.dt_s:g} s apart, stored {table.orientation}"))
    except PlenoPIVError as error:
        lines.append(("frames", f"not usable yet: {printable(str(error))}"))
    for warning in experiment.warnings():
        warnings.warn(f"{file}: {warning}", PlenoPIVWarning, stacklevel=2)
    return lines


def _results(file: Path) -> Lines:
    """Of tracks, of statistics or of a velocity field."""
    from plenopiv.io.series_statistics import holds_statistics
    from plenopiv.io.tracks_file import holds_tracks

    if file.is_file() and holds_tracks(file):
        return _tracks(file)
    return _statistics(file) if file.is_file() and holds_statistics(file) else _velocity(file)


def _tracks(file: Path) -> Lines:
    from plenopiv.io.tracks_file import read_tracks

    tracks = read_tracks(file)
    frame, number = tracks["frame"].values, tracks["track_id"].values
    linked = number >= 0
    seen = np.unique(number[linked], return_counts=True)[1]
    longest = f", the longest of {seen.max()} frames" if seen.size else ""
    lines = [
        ("particles", f"{frame.size}, in {np.unique(frame).size} frames"),
        ("tracks", f"{seen.size}{longest}; {100 * linked.mean() if frame.size else 0:.1f} % of the particles on one"),
    ]
    lines += [(axis, _span(tracks[axis].values, ".4g", "mm")) for axis in "xyz"]
    return lines + [(name, _span(tracks[name].values, "+.4g", "m/s", mean=True)) for name in "uvw"]


def _statistics(file: Path) -> Lines:
    import xarray

    with xarray.open_dataset(file, engine="h5netcdf", decode_times=False) as found:
        phases = f", {found.sizes['phase']} phases" if "phase" in found.sizes else ""
        sizes = " x ".join(str(found.sizes[axis]) for axis in "xyz")
        lines = [("statistics", f"of {found.attrs.get('pairs', '?')} pairs{phases}; {sizes} places along x, y, z")]
        lines += [(axis, _span(found[axis].values, ".4g", "mm")) for axis in "xyz"]
        for name in "uvw":
            mean, rms = (found[f"{name}_{what}"].values for what in ("mean", "rms"))
            lines.append((name, f"mean {_span(mean, '+.4g', 'm/s')}; RMS {_span(rms, '.4g', 'm/s')}"))
        return lines


def _span(values: NDArray, form: str, unit: str, mean: bool = False) -> str:
    """Lowest and highest of the values that there are."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "none"
    middle = f", mean {known.mean():{form}}" if mean else ""
    return f"{known.min():{form}} to {known.max():{form}} {unit}{middle}"


def _velocity(file: Path) -> Lines:
    from plenopiv.io.netcdf import read_velocity
    from plenopiv.velocity import replaced, vectors_inside_body

    dataset = read_velocity(file)
    sizes = dataset.sizes
    vectors = prod(sizes[name] for name in ("time", "z", "y", "x"))
    valid = dataset["valid"].values == 1
    absent = vectors - int((valid | replaced(dataset).values).sum())
    lines = [
        ("vectors", f"{sizes['x']} x {sizes['y']} x {sizes['z']} at {sizes['time']} time(s), {vectors} in all"),
        (
            "valid",
            f"{100 * valid.mean():.1f} % measured, the rest {'replaced' if not absent else 'replaced or missing'}",
        ),
    ]
    if absent:
        lines.append(("missing", f"{absent}, of pairs that were set aside or inside the body"))
    if (inside := vectors_inside_body(dataset)) is not None:
        lines.append(("inside body", f"{inside}, not measured"))
    for axis in "xyz":
        lines.append((axis, _span(dataset[axis].values, ".4g", "mm")))
    if valid.any():
        lines += [(name, _span(dataset[name].values[valid], "+.4g", "m/s", mean=True)) for name in "uvw"]
    return lines


def _image(file: Path) -> Lines:
    from plenopiv.recording.sources import sources_of

    images = sources_of(file)
    counts = images[0].counts(even=True)
    rows, columns = counts.shape
    low, middle, high = np.percentile(counts, (1, 50, 99.9))
    several = [("images", f"{len(images)}; of the first:")] if len(images) > 1 else []
    return [
        *several,
        ("size", f"{columns} x {rows} px (columns x rows), {counts.dtype}"),
        ("counts", f"{counts.min()} to {counts.max()}; 1 %: {low:.0f}, median {middle:.0f}, 99.9 %: {high:.0f}"),
        ("at maximum", f"{100 * np.mean(counts == counts.max()):.2g} % of the pixels"),
    ]
