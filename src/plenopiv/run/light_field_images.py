"""Pictures of a recording's light field: a sheet of views, and refocused depths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.lightfield import LightField, decode, layout
from plenopiv.recording import Recording
from plenopiv.refocusing import image_axes, refocused, sub_aperture
from plenopiv.run import space
from plenopiv.run.calibrated import calibrated_camera
from plenopiv.run.drift import with_drift
from plenopiv.run.frame import Progress

RIM = 0.87  # of the aperture's radius: further out a pixel is lit under some microlenses alone
HOLES = 0.15  # share of a picture without light, above which a view at the rim is left out
DEPTHS = 6  # where none are asked for


@dataclass(frozen=True)
class Views:
    """Some views as they lie on the main lens: ``pictures[row][column]`` (y, x) in counts, the uppermost row first,
    None where the aperture has no view; ``u_mm`` of columns, ``v_mm`` of rows; axes ``x_mm`` and ``y_mm``."""

    pictures: list[list[NDArray[np.float32] | None]]
    u_mm: NDArray[np.float64]
    v_mm: NDArray[np.float64]
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]


def light_field(experiment: Experiment, frame: str | None) -> tuple[LightField, Recording, int]:
    """The light field of a frame, by its name or its number from 1, its recording, and its number in there from 0; the
    first by default.

    Raises:
        PlenoPIVError: there is no such frame, an image cannot be used, or no lattice is found.
    """
    recording = experiment.recording()
    k = number_of(recording, frame)
    camera, _ = calibrated_camera(experiment, recording)
    if experiment.drift_measured:
        camera, _ = with_drift(camera, recording)
    return decode(recording.frame(k), layout(camera)), recording, k


def number_of(recording: Recording, frame: str | None) -> int:
    """Which frame (from 0) is meant.

    Raises:
        PlenoPIVError: none is.
    """
    names = recording.names
    if frame is None:
        return 0
    if frame in names:
        return names.index(frame)
    if frame.isdecimal() and 1 <= int(frame) <= len(names):
        return int(frame) - 1
    shown = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
    raise PlenoPIVError(f"{frame}: is no frame of this recording; give a name ({shown}) or a number from 1")


def views(lightfield: LightField, across: int) -> Views:
    """``across`` views along the diameter of the aperture, evenly spaced, and as many rows of them."""
    where = lightfield.layout
    camera = where.camera
    reach = int(RIM * camera.aperture_radius_px)
    picked = np.unique(np.rint(np.linspace(-reach, reach, min(across, 2 * reach + 1))).astype(int))
    number = {(int(m), int(n)): k for k, (m, n) in enumerate(where.offsets)}
    x, y = image_axes(camera)

    def seen(m: int, n: int) -> NDArray[np.float32] | None:
        picture = sub_aperture(lightfield, number[m, n], x, y).values if (m, n) in number else None
        return None if picture is None or np.isnan(picture).mean() > HOLES else picture

    return Views(
        [[seen(m, n) for m in picked.tolist()] for n in picked.tolist()],
        picked * camera.portion_mm,
        -picked * camera.portion_mm,
        x,
        y,
    )


def focal_stack(
    lightfield: LightField, z_mm: Sequence[float], progress: Progress | None = None
) -> tuple[list[NDArray[np.float32]], NDArray[np.float64], NDArray[np.float64]]:
    """Refocused pictures (y, x), half a microlens a pixel, and their axes x (rising) and y (falling) in mm.

    Raises:
        PlenoPIVError: a depth is not in front of the main lens.
    """
    camera = lightfield.layout.camera
    x, y = image_axes(camera, 0.5 * camera.lattice.pitch_mm / abs(camera.main_lens.magnification))
    pictures = []
    for k, z in enumerate(z_mm):
        pictures.append(refocused(lightfield, z, x, y).values)
        if progress:
            progress("refocusing", k + 1, len(z_mm))
    return pictures, x, y


def depths(experiment: Experiment) -> list[float]:
    """Depths in mm, in the camera's frame, spread over the volume."""
    lo, hi = experiment.volume.z_mm
    if (map_ := space.space_of(experiment, experiment.recording())) is not None:
        lo, hi = map_.lens_limits(experiment.grid().limits_mm())[2]
    return [float(z) for z in np.linspace(lo, hi, DEPTHS + 2)[1:-1]]
