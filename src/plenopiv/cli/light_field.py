"""``plenopiv views``, ``refocus``, ``check`` and ``preview``: inspect a recording before a run."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from math import inf
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

from plenopiv.cli.progress import Progress
from plenopiv.cli.run import of_option
from plenopiv.cli.terminal import Outcome, coloured
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning, printable
from plenopiv.experiment import Experiment

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from plenopiv.checks import Finding

FOLDER = "look"  # beside the experiment file
COLOUR = {"good": "green", "warning": "yellow", "unusable": "red"}
LETTERS = 96  # in a line of text


def views(file: Path, frame: str | None, across: int) -> Outcome:
    """Draw a contact sheet of views of one frame.

    Raises:
        PlenoPIVError: the experiment file, its images or the frame's name are wrong.
    """
    experiment = Experiment.load(file)
    from plenopiv.report.light_field import contact_sheet
    from plenopiv.run import light_field_images

    lightfield, recording, k = light_field_images.light_field(experiment, frame)
    seen = light_field_images.views(lightfield, across)
    sheet = contact_sheet(seen.pictures, seen.u_mm, seen.v_mm, seen.x_mm, seen.y_mm, recording.names[k])
    return _drawn(experiment, f"views-{recording.stem(k)}.png", sheet)


def refocus(file: Path, z_mm: Sequence[float], frame: str | None) -> Outcome:
    """Draw one frame refocused at each depth, by default some spread over the volume.

    Raises:
        PlenoPIVError: as ``views`` does, or a depth is not in front of the main lens.
    """
    experiment = Experiment.load(file)
    lens_z = experiment.camera().main_lens.object_distance_mm
    for z in z_mm:
        if not -inf < z < lens_z:
            raise PlenoPIVError(
                f"--z {z:g}: depths must be finite, in front of the main lens, which is at z = {lens_z:.6g} mm"
            )
    from plenopiv.report.light_field import depth_strip
    from plenopiv.run import light_field_images

    lightfield, recording, k = light_field_images.light_field(experiment, frame)
    depths = list(z_mm) or light_field_images.depths(experiment)
    with Progress() as progress:
        pictures, x, y = light_field_images.focal_stack(lightfield, depths, progress)
    strip = depth_strip(pictures, depths, x, y, recording.names[k])
    return _drawn(experiment, f"refocus-{recording.stem(k)}.png", strip)


def check(file: Path, every: bool = False) -> Outcome:
    """Print whether a recording is good, and draw the images and curves behind it; exit code 2 where it is unusable.
    ``every``: all of its frames are read, not a sample.

    Raises:
        PlenoPIVError: the experiment file or its images cannot be read.
    """
    experiment = Experiment.load(file)
    recording = experiment.recording()
    for line in experiment.warnings():
        warnings.warn(line, PlenoPIVWarning, stacklevel=2)
    from plenopiv.checks import PairCheck, check, every_pair
    from plenopiv.report.check import check_figure
    from plenopiv.run import space

    with Progress() as progress:
        grid = space.grid_of(experiment, space.space_of(experiment, recording))
        look = partial(check, stated=experiment.calibration is None, blur_measured=experiment.blur_measured)
        look = partial(look, drift_measured=experiment.drift_measured)
        found = look(recording, experiment.camera(), grid, experiment.correlation.settings(), progress)
        if every:
            pairs = PairCheck(recording.sensor, found.white_now, found.camera, recording.unusable)
            found = replace(found, findings=(*found.findings, *every_pair(recording, pairs, progress)))
    drawn = _drawn(experiment, "check.png", check_figure(found))
    lines = [line for finding in found.findings for line in _finding_lines(finding)]
    bad = sum(finding.severity == "warning" for finding in found.findings)
    verdict = "not usable as it is" if not found.usable else f"usable, {bad} to look at" if bad else "good"
    text = "\n".join([*lines, "", f"{file}: {verdict}", drawn.text])
    facts = {"usable": found.usable, "findings": [asdict(finding) for finding in found.findings], **drawn.facts}
    return Outcome(text, facts, 0 if found.usable else 2)


def preview(file: Path, device: str | None = None) -> Outcome:
    """Measure the middle of a recording coarsely, on another ``device`` than the file's.

    Raises:
        PlenoPIVError: as ``plenopiv run`` does, or the volume leaves out the middle.
    """
    experiment = of_option(Experiment.load(file), device)
    from plenopiv.run.preview import preview

    with Progress() as progress:
        result = preview(experiment, progress)
    velocity, folder = result.velocity, result.directory
    lines = []
    for name, axis in zip("uvw", "xyz", strict=True):
        low, middle, high = velocity[name].quantile([0.05, 0.5, 0.95]).values.tolist()
        lines.append(f"{name}  {low:+.3g} to {high:+.3g} m/s along {axis}, median {middle:+.3g} (5 % to 95 %)")
    share = 100 * result.summary["replaced_share"]
    lines.append(f"{result.summary['vectors']} vectors of the middle, {share:.0f} % replaced; coarse: no measurement")
    files = [folder / name for name in ("velocity.nc", "preview.png", "report.html")]
    return Outcome("\n".join([*lines, *map(str, files)]), {"files": [str(path) for path in files]})


def _finding_lines(finding: Finding) -> list[str]:
    """A finding and its advice, wrapped."""
    first, *rest = wrap(finding.words, LETTERS)
    head = coloured(f"{finding.severity:<9}", COLOUR[finding.severity], sys.stdout)
    lines = [f"{head} {first}", *(f"{'':<9} {line}" for line in rest)]
    return lines + [
        f"{'':<9} {'->' if k == 0 else '  '} {line}" for k, line in enumerate(wrap(finding.advice, LETTERS - 3))
    ]


def _drawn(experiment: Experiment, name: str, figure: Figure) -> Outcome:
    """Save a figure beside the experiment file."""
    from plenopiv.io.output import OutputFolder
    from plenopiv.report.figures import png

    folder = experiment.folder / FOLDER
    with OutputFolder(folder, overwrite=True) as out:
        out.write_bytes(name, png(figure))
    return Outcome(printable(str(folder / name)), {"files": [str(folder / name)]})
