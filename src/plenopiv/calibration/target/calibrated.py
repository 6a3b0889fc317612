"""A camera calibrated with a target: the thin lens that stands for it, its optics, and how far its dots lie off."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import radians

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.calibration.lattice_fit import LatticeFit
from plenopiv.calibration.target.board import Board, TargetImage
from plenopiv.calibration.target.fit import Dots, Progress, measure_dots
from plenopiv.calibration.target.optics_fit import NAMES, OpticsFit, fit_optics
from plenopiv.calibration.target.pupil import outline, pupil_and_stop
from plenopiv.cameras.lens_space import space_map
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import LensRim, MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel
from plenopiv.cameras.space_map import SpaceMap, ViewShift
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.lightfield import layout
from plenopiv.volume import Limits

BLOCKS = 3  # of the field along x and along y
DISAGREES = 8.0  # times the others' RMS residual: a plane so far off was not where it is said to be
DISAGREES_MM = 0.02
OFF_SHEET = 4.0  # standard deviations of a stated figure from which on it, or the target's, is doubtful
GROWTH = 0.6, 1.6  # of a micro-image pitch over the microlenses', beyond what the data sheet's lengths say


@dataclass(frozen=True)
class PlaneResidual:
    """Of one plane: dots found, those seen whole, RMS and mean (x, y, z), in um, by which these lie off in the
    laboratory when the plane is left out of the fit; and how many of these are not counted: they lie off all others,
    dirty or half hidden."""

    image: str
    z_mm: float
    dots: int
    whole: int
    rms_um: tuple[float, float, float]
    mean_um: tuple[float, float, float]
    outliers: int = 0


@dataclass(frozen=True)
class TargetCalibration:
    """``camera``: the thin lens in air of lens space, with the array's lattice. ``model``: the rays of the laboratory.
    ``values``, ``std``: physical parameters (``optics_fit.NAMES``, ``magnification``). ``planes``: residuals by depth.
    ``field_um``: RMS (x, y, z) by blocks of the field, rows from +y down, columns from -x. ``views_um``: of the views
    that were used, pixel offset (m, n) and mean shift (s, t) on the microlens plane. ``beside``: how far rays fall
    beside all that, as particles show it (``plenopiv selfcalibrate``); None where they were not asked."""

    camera: PlenopticCamera
    model: RayModel
    values: dict[str, float]
    std: dict[str, float]
    planes: tuple[PlaneResidual, ...]
    field_um: tuple[tuple[tuple[float, float, float], ...], ...]
    views_um: tuple[tuple[int, int, float, float], ...]
    beside: ViewShift | None = None

    def __repr__(self) -> str:
        return f"<TargetCalibration {len(self.planes)} planes, {self.camera!r}>"

    def space(
        self, laboratory: Limits, origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0), turn_deg: float = 0.0
    ) -> SpaceMap:
        """The map between a volume of the laboratory and lens space, the laboratory's origin at ``origin_mm`` of the
        target's frame, its axes turned by ``turn_deg`` about z there."""
        model = replace(self.model, origin_mm=origin_mm, laboratory_turn_rad=radians(turn_deg))
        found = space_map(model, self.camera, laboratory)
        if self.beside is None:
            return found
        return replace(found, left=self.beside if found.left is None else found.left.plus(self.beside))


def lens_space_camera(camera: PlenopticCamera, fit: LatticeFit, radius_px: float) -> PlenopticCamera:
    """The thin lens that stands for a camera of which a white image shows the lattice ``fit`` and micro-images of
    ``radius_px``. ``camera``: as the data sheet says.

    The array's pitch, which lithography gives, is taken from the data sheet; the micro-images' tells how much larger
    they are apart, f_l over the distance of the plane through whose middle they all look.

    Raises:
        PlenoPIVError: the pitches do not go together.
    """
    growth = fit.image_pitch_px * camera.sensor.pixel_pitch_mm / camera.lattice.pitch_mm - 1
    low, high = (bound * camera.image_scale for bound in GROWTH)
    if not low < growth < high:
        raise PlenoPIVError(
            f"camera.microlens_array.pitch_mm: micro-images are {1 + growth:.5f} pitches apart, and "
            f"{1 + camera.image_scale:.5f} were expected: give the array's pitch as its maker states it, to 1e-4"
        )
    magnification = camera.main_lens.magnification
    distance = camera.microlens_focal_length_mm / growth
    aperture = 2 * radius_px * camera.sensor.pixel_pitch_mm / growth
    rim, wider = fit.rim, camera.image_scale / growth
    if rim is not None:
        rim = LensRim(wider * rim.radius_mm, wider * rim.slip, (wider * rim.start_mm[0], wider * rim.start_mm[1]))
    return PlenopticCamera(
        MainLens(distance / (1 - magnification), aperture, magnification),
        fit.lattice.scaled((1 + camera.image_scale) / (1 + growth)),
        camera.microlens_focal_length_mm,
        camera.sensor,
        rim,
    )


def calibrate_target(
    images: Sequence[TargetImage],
    board: Board,
    camera: PlenopticCamera,
    medium: Medium | None = None,
    counts_per_electron: float = 1.0,
    unusable: NDArray[np.bool_] | None = None,
    white: NDArray | None = None,
    progress: Progress | None = None,
    focal_length_mm: float | None = None,
) -> TargetCalibration:
    """The calibration that ``images`` of a target give. ``camera``: as ``lens_space_camera`` gives it;
    ``focal_length_mm``: of the lens, as the data sheet says. ``medium``: fluid and window, as far as they are known.
    ``unusable``: pixels (rows, columns) that are no equations. ``white``: the white image, upright, whose micro-images'
    outlines tell exit pupil and stop.

    Raises:
        PlenoPIVError: naming the image or the key: there is no target, its planes are out of order, all at one z, or
            disagree, or its dots do not determine the optics.
    """
    where = layout(camera, unusable)
    dots = measure_dots(images, board, where, counts_per_electron, progress)
    optics = fit_optics(dots, camera, medium, focal_length_mm)
    values, std = optics.values, optics.std
    if white is not None and (seen := outline(white, camera)) is not None:
        which = [NAMES.index(f"{name}_mm") for name in ("focal_length", "image_distance", "microlens_focal_length")]
        lengths = np.array([values[NAMES[n]] for n in which])
        more = pupil_and_stop(seen, camera, lengths, optics.covariance[np.ix_(which, which)])
        values, std = values | more[0], std | more[1]
    planes = tuple(_plane(image, n, dots, optics) for n, image in enumerate(images))
    _warn_of_three_planes(dots, optics)
    _check_agreement(planes, [1e3 * optics.without_mm.get(n, np.full(3, np.nan)) for n in range(len(planes))])
    stated = {"microlens_focal_length_mm": camera.microlens_focal_length_mm}
    _compare_with_sheet(optics, stated if medium is None else stated | {"refractive_index": medium.refractive_index})
    used = np.isfinite(dots.view_shift_mm).all(2).any(0)
    shift = 1e3 * np.nanmean(dots.view_shift_mm[:, used], 0)
    views = tuple((*offset, *st) for offset, st in zip(where.offsets[used].tolist(), shift.tolist(), strict=True))
    return TargetCalibration(camera, optics.model, values, std, planes, _field(dots, optics), views)


def _plane(image: TargetImage, number: int, dots: Dots, optics: OpticsFit) -> PlaneResidual:
    here = dots.plane == number
    whole, used = here & dots.whole, here & optics.used
    counted = used if 2 * used.sum() >= whole.sum() else whole  # of a plane that is elsewhere all dots are off
    off = 1e3 * optics.left_out_mm[counted]
    unknown = [float("nan")] * 3
    rms, mean = (np.sqrt((off**2).mean(0)).tolist(), off.mean(0).tolist()) if len(off) else (unknown, unknown)
    dots_whole = int(whole.sum())
    return PlaneResidual(
        image.name, image.z_mm, int(here.sum()), dots_whole, tuple(rms), tuple(mean), dots_whole - len(off)
    )


def _field(dots: Dots, optics: OpticsFit) -> tuple[tuple[tuple[float, float, float], ...], ...]:
    """RMS residual (x, y, z) in um by blocks of the field."""
    places, out = dots.laboratory_mm[:, :2], []
    low, high = places.min(0), places.max(0)
    block = np.clip(((places - low) / (high - low) * BLOCKS).astype(int), 0, BLOCKS - 1)
    for row in reversed(range(BLOCKS)):
        line = []
        for column in range(BLOCKS):
            off = 1e3 * optics.residual_mm[(block == (column, row)).all(1) & optics.used]
            rms = np.sqrt((off**2).mean(0)).tolist() if len(off) else [float("nan")] * 3
            line.append((rms[0], rms[1], rms[2]))
        out.append(tuple(line))
    return tuple(out)


def _check_agreement(planes: Sequence[PlaneResidual], others_um: Sequence[ArrayLike]) -> None:
    """A plane that is not where the others say it is. ``others_um``: RMS residual (3,) along x, y, z of all others when
    a plane is left out of the fit. A plane that is wrong bends every fit that it is part of: only where it is left out
    do the others agree."""
    if len(planes) < 4:
        return
    off = np.array([plane.mean_um for plane in planes])
    beyond = np.abs(off) / np.maximum(DISAGREES * np.array(others_um), 1e3 * DISAGREES_MM)
    worst, axis = divmod(int(np.argmax(np.nan_to_num(beyond))), 3)
    if beyond[worst, axis] <= 1:
        return
    plane, by_mm = planes[worst], 1e-3 * off[worst, axis]
    if axis == 2:
        raise PlenoPIVError(
            f"calibration.planes: {plane.image} is said to be at z = {plane.z_mm:g} mm; by the other planes it is at "
            f"{plane.z_mm + by_mm:.3f} mm: correct its z_mm, or leave the image out"
        )
    raise PlenoPIVError(
        f"calibration.planes: the dots of {plane.image} lie {by_mm:+.3f} mm along {'xy'[axis]} from where the other "
        "planes have them: the target was moved aside, or another dot was taken for its origin; leave the image out"
    )


def _warn_of_three_planes(dots: Dots, optics: OpticsFit) -> None:
    """Warn where dots of three planes do not lie where any optics have them: which plane is wrong they cannot tell."""
    if len(optics.without_mm) > 3:
        return
    off = np.sqrt((optics.residual_mm[optics.used] ** 2).mean(0))
    known = np.maximum(DISAGREES * np.median(dots.std_mm[optics.used], 0), DISAGREES_MM)
    axis = int(np.argmax(off / known))
    if off[axis] > known[axis]:
        warnings.warn(
            f"calibration.planes: the planes disagree: their dots lie {off[axis]:.3f} mm (RMS) along {'xyz'[axis]} "
            "from where the fit has them; check every z_mm, and that the target was not moved aside: a fourth plane "
            "would tell which one is wrong",
            PlenoPIVWarning,
            stacklevel=3,
        )


def _compare_with_sheet(optics: OpticsFit, stated: Mapping[str, float]) -> None:
    """Warn of figures that are far from the ``stated`` ones, by their names: a wrong pitch of the dots, or steps of the
    traverse, look like another camera."""
    for name, figure in stated.items():
        if optics.off_sheet[name] > OFF_SHEET:
            warnings.warn(
                f"calibration: by the dots {name} is {optics.values[name]:.4g}, {optics.off_sheet[name]:.0f} standard "
                f"deviations of such a figure from the {figure:.4g} that is stated; check calibration.pitch_mm, z_mm "
                "and the figure",
                PlenoPIVWarning,
                stacklevel=3,
            )
