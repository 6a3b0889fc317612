"""``plenopiv calibrate``: the lattice of microlenses from the white image, and the camera from images of a target."""

from __future__ import annotations

from math import degrees, floor, hypot, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plenopiv.calibration import LatticeFit, find_lattice, save_lattice
from plenopiv.cli.progress import Progress
from plenopiv.cli.terminal import Outcome
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment

if TYPE_CHECKING:
    from plenopiv.calibration.target.calibrated import TargetCalibration
    from plenopiv.recording import Recording

FILE = "lattice.toml"
FIGURE = "calibration.png"
UNDETERMINED = 0.05  # standard deviation beyond which a parameter is not known: of its value, or as a share

# names of parameters: in words, unit, and how many units the calibration's unit is; lengths and the index are judged by
# their relative standard deviation, shares by the absolute one, and poses are always known
LENGTHS = {
    "magnification": ("magnification", ""),
    "focal_length_mm": ("focal length", "mm"),
    "image_distance_mm": ("image distance", "mm"),
    "exit_pupil_mm": ("exit pupil to array", "mm"),
    "exit_pupil_radius_mm": ("radius of the exit pupil", "mm"),
    "stop_mm": ("stop before the lens", "mm"),
    "stop_radius_mm": ("radius of the stop", "mm"),
    "rim_radius_mm": ("radius of the lens' rim", "mm"),
    "reference_mm": ("middle of the views to array", "mm"),
    "microlens_focal_length_mm": ("microlenses to sensor", "mm"),
    "gap_mm": ("window to lens", "mm"),
    "fluid_mm": ("z = 0 to window", "mm"),
    "refractive_index": ("index of the fluid", ""),
}
SHARES = {
    "distortion": ("distortion at the corner", "%"),
    "gap_tilt_s": ("gap at the corner, along s", "%"),
    "gap_tilt_t": ("gap at the corner, along t", "%"),
}
POSE = {
    "turn_x_rad": ("laboratory turned about x", "deg"),
    "turn_y_rad": ("laboratory turned about y", "deg"),
    "turn_z_rad": ("laboratory turned about z", "deg"),
    "plane_turn_x_rad": ("dots off square, about x", "deg"),
    "plane_turn_y_rad": ("dots off square, about y", "deg"),
    "x_mm": ("laboratory's origin, x", "mm"),
    "y_mm": ("laboratory's origin, y", "mm"),
}


def calibrate(file: Path, overwrite: bool) -> Outcome:
    """Find the lattice and, with [calibration], what the target shows; save both beside the experiment file.

    Raises:
        PlenoPIVError: the experiment file or its images are wrong, there is no white image, no lattice is found in it,
            the target does not determine the camera, or a file is already there; then nothing is written.
    """
    experiment = Experiment.load(file)
    recording = experiment.recording()
    white = recording.white()
    if white is None:
        raise PlenoPIVError(f"{file}: recording.white is missing; a calibration needs the white image")
    from plenopiv.run.target import FILE as CALIBRATION

    saved = experiment.folder / FILE
    written = [saved] if experiment.calibration is None else [saved, experiment.folder / CALIBRATION]
    for path in written:
        if path.exists() and not overwrite:
            raise PlenoPIVError(f"{path}: is already there; use --overwrite to replace it")
    with Progress() as progress:
        fit = find_lattice(white, experiment.camera(), str(recording.white_path))
        found = None if experiment.calibration is None else _of_target(experiment, recording, fit, progress)
    save_lattice(fit, saved)
    lines, facts = _lattice_lines(fit), {"files": [str(path) for path in written], "lattice": _lattice_facts(fit)}
    if found is not None:
        figure = _save(found, experiment, recording, written[-1])
        facts = {**facts, "files": [*facts["files"], str(figure)], "target": facts_of(found)}
        lines += lines_of(found)
    return Outcome("\n".join([*lines, *(f"saved      {path}" for path in facts["files"])]), facts)


def _of_target(experiment: Experiment, recording: Recording, fit: LatticeFit, progress: Progress) -> TargetCalibration:
    from plenopiv.run.target import make_calibration

    return make_calibration(experiment, recording, fit, progress)


def _save(found: TargetCalibration, experiment: Experiment, recording: Recording, path: Path) -> Path:
    """Write calibration.toml and draw it; returns the figure's path."""
    from plenopiv.io.aside import written_aside
    from plenopiv.io.calibration_file import save_calibration
    from plenopiv.report.calibration import calibration_figure
    from plenopiv.report.figures import png
    from plenopiv.run.target import inputs_of

    save_calibration(found, inputs_of(experiment, recording), path)
    drawn = png(calibration_figure(found))
    with written_aside(path.with_name(FIGURE)) as aside:
        aside.write_bytes(drawn)
    return path.with_name(FIGURE)


def _lattice_lines(fit: LatticeFit) -> list[str]:
    s, t = fit.offset_mm
    return [
        f"lattice    {fit.lattice.kind}, {fit.microlenses} microlenses, {fit.rejected} left out",
        f"pitch      {1e3 * fit.lattice.pitch_mm:.4f} um; micro-images every {fit.image_pitch_px:.5f} px",
        f"rotation   {fit.rotation_deg:+.4f} deg, counter-clockwise in (s, t)",
        f"array      {fit.map_words}; rows {100 * -fit.stretch:+.4f} % further apart than lenses along them, "
        f"{1e3 * fit.shear_rad:+.3f} mrad off a right angle",
        f"offset     s = {1e3 * s:+.2f} um, t = {1e3 * t:+.2f} um",
        f"residual   {fit.residual_px:.3f} px RMS, {fit.worst_px:.3f} px at 99.9 %, "
        f"{fit.worst_region_px:.3f} px in the worst region",
    ]


def _lattice_facts(fit: LatticeFit) -> dict[str, Any]:
    return {
        "kind": fit.lattice.kind,
        "pitch_mm": fit.lattice.pitch_mm,
        "rotation_deg": fit.rotation_deg,
        "offset_mm": list(fit.offset_mm),
        "microlenses": fit.microlenses,
        "residual_px": fit.residual_px,
    }


def undetermined(calibration: TargetCalibration, name: str) -> bool:
    """Whether the dots and the data sheet leave a parameter open."""
    if name in POSE:
        return False
    of = "focal_length_mm" if name == "stop_mm" else name  # a stop may stand at the lens
    scale = 1.0 if name in SHARES else abs(calibration.values[of])
    return not calibration.std[name] <= UNDETERMINED * scale


def lines_of(calibration: TargetCalibration) -> list[str]:
    """A calibration with a target as text: dots, parameters, residuals by plane, the largest shift in a view."""
    dots, whole = (sum(getattr(plane, key) for plane in calibration.planes) for key in ("dots", "whole"))
    outliers = sum(plane.outliers for plane in calibration.planes)
    beside = f", {outliers} of these left out: they lie off all others" if outliers else ""
    lines = [f"target     {dots} dots in {len(calibration.planes)} planes, {whole} of them seen whole{beside}", ""]
    for name, (words, unit) in {**LENGTHS, **SHARES, **POSE}.items():
        if name not in calibration.values:
            continue  # micro-images that the lens' rim does not clip do not show the exit pupil
        factor = {"%": 100.0, "deg": degrees(1.0)}.get(unit, 1.0)
        value, std = factor * calibration.values[name], factor * calibration.std[name]
        sign, places = "+" if name in SHARES or name in POSE else "", _places(std)
        known = f"{value:{sign}.{places}f} +- {std:.{places}f} {unit}".rstrip()
        lines.append(f"{words:<30}" + (f"undetermined ({known})" if undetermined(calibration, name) else known))
    lines += ["", "RMS in um by which dots of a plane lie off that is left out of the fit:"]
    lines.append(f"{'z (mm)':>8} {'dots':>6} {'whole':>6} {'x':>7} {'y':>7} {'z':>7}  image")
    for plane in sorted(calibration.planes, key=lambda p: p.z_mm):
        x, y, z = plane.rms_um
        lines.append(f"{plane.z_mm:8.3f} {plane.dots:6d} {plane.whole:6d} {x:7.2f} {y:7.2f} {z:7.2f}  {plane.image}")
    if calibration.views_um:
        m, n, s, t = max(calibration.views_um, key=lambda view: hypot(*view[2:]))
        lines += ["", f"largest shift of all dots in a view: {hypot(s, t):.2f} um, in that of pixel ({m:+d}, {n:+d})"]
    return [*lines, ""]


def facts_of(calibration: TargetCalibration) -> dict[str, Any]:
    """The same as plain data; None for what is not known."""
    parameters = {
        name: {"value": value, "std": calibration.std[name], "undetermined": undetermined(calibration, name)}
        for name, value in calibration.values.items()
    }
    planes = [
        {
            "image": plane.image, "z_mm": plane.z_mm, "dots": plane.dots, "whole": plane.whole,
            "outliers": plane.outliers,
            "rms_um": _plain(plane.rms_um), "mean_um": _plain(plane.mean_um),
        }
        for plane in calibration.planes
    ]  # fmt: skip
    return {
        "parameters": parameters,
        "planes": planes,
        "field_um": [[_plain(block) for block in row] for row in calibration.field_um],
        "largest_view_shift_um": max((hypot(s, t) for _, _, s, t in calibration.views_um), default=None),
    }


def _plain(values: tuple[float, ...]) -> list[float | None]:
    """JSON has no NaN."""
    return [value if value == value else None for value in values]


def _places(std: float) -> int:
    """Decimal places that show the second digit of a standard deviation."""
    return min(max(1 - floor(log10(std)), 0), 6) if std > 0 else 6
