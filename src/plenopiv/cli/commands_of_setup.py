"""Commands on how a camera is set up: more of ``cli.app``, which they join when ``plenopiv.cli`` is imported."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from plenopiv.cli.app import ExperimentFile, _finish
from plenopiv.cli.commands_of_tracks import app


class Where(StrEnum):
    """As seen from behind the camera."""

    right = "right"
    left = "left"
    up = "up"
    down = "down"


@app.command()
def orientation(
    experiment: ExperimentFile,
    images: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGE...", help="One of a letter F, or of a target: before and after each motion."),
    ],
    moved: Annotated[
        list[Where] | None,
        typer.Option(metavar="WHERE", help="right, left, up or down: how the target moved to the next image."),
    ] = None,
) -> None:
    """Settle recording.orientation: no image of particles tells whether it is stored upright or turned.

    A wrong orientation reverses u and v, and nothing else shows it. Record images with the camera of EXPERIMENT, saved
    as its frames are, of one of these in the focal plane:

    \b
        a printed letter F, a third of the field or larger, held so that you can read it from behind the camera
        a target with a pattern that does not repeat itself, before and after you move it sideways

    Directions are as you see them from behind the camera. An F tells all; one motion cannot tell a turned image from
    a mirrored one, two (right, then up) can. Prints what to put into EXPERIMENT, and whether it is there; exit code 2
    where images are mirrored or turned by 90 degrees, which no orientation describes. Nothing is written.

    \b
    Example:
        plenopiv orientation run7/experiment.toml letter.tif
        plenopiv orientation run7/experiment.toml t0.tif t1.tif --moved right
        plenopiv orientation run7/experiment.toml t0.tif t1.tif t2.tif --moved right --moved up
    """
    from plenopiv.cli.orientation import orientation

    _finish("orientation", orientation(experiment, images, [where.value for where in moved or []]))


@app.command()
def selfcalibrate(experiment: ExperimentFile) -> None:
    """Correct a calibration with a target by the particles of the recording.

    What a target leaves wrong of the views against each other, by place and depth, particles of the first pair show:
    views are shifted, by smooth polynomials, until each particle's light in all views is that of one point. The second
    frame judges: where it is not explained better, nothing is changed. The correction goes into calibration.toml, where
    plenopiv run finds it; plenopiv calibrate --overwrite takes it out again.

    A shift of all that is seen, a scale and a shift of depth cannot be told from particles: they stay the target's.

    \b
    Example:
        plenopiv calibrate run7/experiment.toml
        plenopiv selfcalibrate run7/experiment.toml
    """
    from plenopiv.cli.self_calibrate import self_calibrate

    _finish("selfcalibrate", self_calibrate(experiment))
