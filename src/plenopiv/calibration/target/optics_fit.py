"""The optics of a camera from a target's dots: lengths, window, pose, distortion, by least squares over traced rays.

Each dot's measured image in lens space is compared with the one that the traced rays of its place in the laboratory
have (``cameras.lens_space``). What the data sheet and [medium] say enters as further equations, as good as such
figures are, so that what the dots cannot tell keeps its stated value with the deviation that this leaves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.target.fit import Dots
from plenopiv.cameras.lens_space import images_of
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.ray_model import OFFSET_POWERS, RayModel, rotation
from plenopiv.errors import PlenoPIVError

NAMES = (
    "focal_length_mm", "image_distance_mm", "gap_mm", "fluid_mm", "refractive_index", "microlens_focal_length_mm",
    "reference_mm", "turn_x_rad", "turn_y_rad", "turn_z_rad", "x_mm", "y_mm", "distortion", "gap_tilt_s", "gap_tilt_t",
    "plane_turn_x_rad", "plane_turn_y_rad",
    *(f"view_offset_{axis}_s{p}_t{q}_mm" for p, q in OFFSET_POWERS for axis in "uv"),
)  # fmt: skip
OF_MODEL = NAMES.index("gap_tilt_t") + 1
LENGTHS = NAMES.index("plane_turn_y_rad") + 1  # the others are the views' offsets
CENTRES_PX = 0.05  # by which middles of micro-images may have been found aside in the sensor's corner
OF_SHEET = "refractive_index", "microlens_focal_length_mm"  # that the experiment file states as they are
SHEET = 0.03  # standard deviation of a stated focal length, relative
MICROLENS_SHEET = 0.01  # of the microlenses': their sagitta is etched
PITCH = 3e-5  # of the array's pitch, which lithography gives
UNKNOWN_INDEX = 1.2, 0.2  # of a fluid that nobody names: from air to oil
STATED_INDEX = 1e-3
STATED_MM = 0.05  # of a stated way in the fluid, relative
SQUARE = 0.02  # rad, of how square a target is to its traverse
FLOOR_MM = np.array([0.15e-3, 0.15e-3, 3e-3])  # what a model does not hold of one dot; of good lenses
FEWEST = 58  # dots seen whole, three equations each; of most numbers something is known beforehand
RAYS = 37
OUTLIER = 6.0


@dataclass(frozen=True)
class OpticsFit:
    """The optics and how well they are known. ``values``, ``std``: by the names of ``NAMES``, but for the views'
    offsets, and ``magnification``; ``covariance``: of all ``NAMES``; ``residual_mm`` (n, 3): of the dots, in the
    laboratory; ``left_out_mm`` (n, 3): the same with the dot's plane left out of the fit; ``without_mm``: RMS residual
    (3,) of all others in the fit that leaves out a plane, by its number; ``used`` (n,): dots that are no outliers;
    ``off_sheet``: by how many standard deviations of the data sheet's figure a fitted one is off, by its name."""

    model: RayModel
    values: dict[str, float]
    std: dict[str, float]
    covariance: NDArray[np.float64]
    residual_mm: NDArray[np.float64]
    left_out_mm: NDArray[np.float64]
    without_mm: dict[int, NDArray[np.float64]]
    used: NDArray[np.bool_]
    off_sheet: dict[str, float]


def fit_optics(
    dots: Dots, camera: PlenopticCamera, medium: Medium | None, focal_length_mm: float | None = None
) -> OpticsFit:
    """The optics that the ``dots`` show. ``camera``: that of the lens space in which they were measured, whose lens
    stands in the exit pupil; ``focal_length_mm``: of the real one, by the data sheet, None where it is that camera's.
    ``medium``: as the file states it, from the plane in focus, None where it says nothing. A traverse may have its zero
    anywhere.

    Raises:
        PlenoPIVError: the dots do not determine the optics.
    """
    problem, in_focus = _Problem.of(camera, medium, focal_length_mm), _in_focus(dots)
    from_focus = dots.laboratory_mm - [0.0, 0.0, in_focus]
    dots = replace(dots, laboratory_mm=from_focus, reading_mm=dots.reading_mm - in_focus)
    used = dots.whole.copy()
    if used.sum() < FEWEST:
        raise PlenoPIVError(
            f"calibration.planes: only {int(used.sum())} dots are seen whole; {FEWEST} or more are needed: "
            "move the target into view, or give more planes"
        )
    start = problem.start(dots.where(used))
    for _ in range(3):
        found = problem.solve(dots.where(used), start)
        start = found.x
        off = np.abs(problem.scaled(start, dots)).max(1)
        now = dots.whole & (off < OUTLIER * max(1.0, float(np.median(off[dots.whole]))))
        if (now == used).all():
            break
        used = now
    left_out, without = np.full((len(dots), 3), np.nan), {}
    for plane in np.unique(dots.plane).tolist():
        here, there = dots.plane == plane, used & (dots.plane != plane)
        others = problem.solve(dots.where(there), start).x
        left_out[here] = problem.in_laboratory(others, dots.where(here))
        without[plane] = np.sqrt((problem.in_laboratory(others, dots.where(there)) ** 2).mean(0))
    of_sheet = np.abs(start - problem.stated) / problem.deviation
    residual, misses = problem.in_laboratory(start, dots), problem.scaled(start, dots.where(used))
    start, turned = _from_the_traverse_s_zero(start, in_focus)
    covariance = turned @ np.linalg.inv(found.jac.T @ found.jac) @ turned.T
    degrees = max(1, 3 * int(used.sum()) - len(NAMES))
    misfit = max(1.0, float((misses**2).sum()) / degrees)
    names = NAMES[:LENGTHS]
    values = dict(zip(names, start.tolist(), strict=False))
    std = dict(zip(names, np.sqrt(np.diag(covariance) * misfit).tolist(), strict=False))
    f, si = values["focal_length_mm"], values["image_distance_mm"]
    slope = np.array([si / f**2, -1 / f])
    values["magnification"] = 1 - si / f
    std["magnification"] = float(np.sqrt(slope @ covariance[:2, :2] @ slope * misfit))
    return OpticsFit(
        problem.model(start),
        values,
        std,
        covariance * misfit,
        residual,
        left_out,
        without,
        used,
        {name: float(of_sheet[NAMES.index(name)]) for name in OF_SHEET},
    )


def _in_focus(dots: Dots) -> float:
    """The traverse's reading, mm, of what is in focus."""
    return float(np.polyfit(dots.lens_mm[dots.whole, 2], dots.laboratory_mm[dots.whole, 2], 1)[1])


def _from_the_traverse_s_zero(
    parameters: NDArray[np.float64], in_focus_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Parameters that hold with z from the plane in focus, as they are with z as the traverse reads it, and the
    derivatives of these by those."""

    def from_zero(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        out, (about_x, about_y, about_z) = parameters.copy(), parameters[[NAMES.index(f"turn_{a}_rad") for a in "xyz"]]
        along_z = rotation(about_x, about_y, about_z)[:, 2]  # of the target, in the camera's frame
        for name, sign, part in zip(("x_mm", "y_mm", "fluid_mm"), (-1, -1, 1), along_z, strict=True):
            out[NAMES.index(name)] += sign * in_focus_mm * part
        return out

    step = 1e-6
    sides = [from_zero(parameters + step * unit) - from_zero(parameters - step * unit) for unit in np.eye(len(NAMES))]
    return from_zero(parameters), np.array(sides).T / (2 * step)


def placed(parameters: NDArray[np.float64], dots: Dots) -> NDArray[np.float64]:
    """Where the dots are in the laboratory (n, 3): z is along the traverse, to which the target is nearly square."""
    about_x, about_y = parameters[[NAMES.index("plane_turn_x_rad"), NAMES.index("plane_turn_y_rad")]].tolist()
    along = dots.reading_mm[:, None] * [0.0, 0.0, 1.0]
    return np.asarray((dots.laboratory_mm - along) @ rotation(about_x, about_y, 0.0).T + along, np.float64)


@dataclass(frozen=True)
class _Problem:
    """Dots and data sheet as least squares. ``stated``, ``deviation`` (parameters,): of each, inf where nothing is
    known; ``unit``: a step of each that matters."""

    camera: PlenopticCamera
    medium: Medium
    stated: NDArray[np.float64]
    deviation: NDArray[np.float64]
    unit: NDArray[np.float64]

    @classmethod
    def of(cls, camera: PlenopticCamera, medium: Medium | None, focal_length_mm: float | None = None) -> _Problem:
        lens, fl = camera.main_lens, camera.microlens_focal_length_mm
        if focal_length_mm is not None:
            lens = replace(lens, focal_length_mm=focal_length_mm)
        inf = np.inf
        index, fluid = UNKNOWN_INDEX, (0.4 * lens.object_distance_mm, 0.2 * lens.object_distance_mm)
        if medium is not None:
            index = medium.refractive_index, STATED_INDEX
            fluid = medium.fluid_mm, STATED_MM * medium.fluid_mm + 1.0
        reference = camera.main_lens.image_distance_mm
        gap = lens.object_distance_mm - fluid[0] / index[0]
        f = lens.focal_length_mm
        rows = {
            "focal_length_mm": (f, SHEET * f, 1.0),
            "image_distance_mm": (lens.image_distance_mm, inf, 1.0),
            "gap_mm": (gap, inf, 1.0),
            "fluid_mm": (*fluid, 10.0),
            "refractive_index": (*index, 0.1),
            "microlens_focal_length_mm": (fl, MICROLENS_SHEET * fl, 0.01 * fl),
            "reference_mm": (reference, inf, 0.01 * reference),
            "turn_x_rad": (0.0, inf, 0.01),
            "turn_y_rad": (0.0, inf, 0.01),
            "turn_z_rad": (0.0, inf, 0.01),
            "x_mm": (0.0, inf, 0.1),
            "y_mm": (0.0, inf, 0.1),
            "distortion": (0.0, 0.1, 0.01),
            "gap_tilt_s": (0.0, 0.1, 0.01),
            "gap_tilt_t": (0.0, 0.1, 0.01),
            "plane_turn_x_rad": (0.0, SQUARE, 0.01),
            "plane_turn_y_rad": (0.0, SQUARE, 0.01),
        }
        aside = CENTRES_PX * camera.portion_mm
        rows |= dict.fromkeys(NAMES[LENGTHS:], (0.0, aside, aside))
        stated, deviation, unit = np.array([rows[name] for name in NAMES]).T
        return cls(camera, medium or Medium(window_mm=0.0), stated, deviation, unit)

    def model(self, parameters: NDArray[np.float64]) -> RayModel:
        """The camera of so many numbers."""
        f, si, gap, fluid, index, fl, reference, ax, ay, az, x, y, k, gs, gt = parameters[:OF_MODEL].tolist()
        offsets = parameters[LENGTHS:].reshape(-1, 2).tolist()
        sensor = self.camera.sensor
        corner = 0.5 * sensor.pixel_pitch_mm * float(np.hypot(sensor.columns, sensor.rows))
        return RayModel(
            f,
            si,
            gap,
            replace(self.medium, refractive_index=index, fluid_mm=fluid),
            reference,
            corner,
            (ax, ay, az),
            (x, y),
            k,
            (gs, gt),
            fl / reference / self.camera.image_scale,
            tuple((float(u), float(v)) for u, v in offsets),
        )

    def start(self, dots: Dots) -> NDArray[np.float64]:
        """The stated numbers, with the pose, the lengths and the index that a linear map of the dots shows."""
        from scipy.optimize import least_squares

        start = self.stated.copy()
        terms = np.column_stack([dots.laboratory_mm, np.ones(len(dots))])
        linear = np.linalg.lstsq(terms, dots.lens_mm, rcond=None)[0]
        start[NAMES.index("turn_z_rad")] = np.arctan2(linear[0, 1] - linear[1, 0], linear[0, 0] + linear[1, 1])
        rough = [NAMES.index(name) for name in ("image_distance_mm", "gap_mm", "refractive_index", "x_mm", "y_mm")]

        def miss(some: NDArray) -> NDArray:
            start[rough] = some
            return self.scaled(start, dots).ravel()

        first = start[rough]
        low, high = np.full(5, -np.inf), np.full(5, np.inf)
        low[2], high[2] = 0.9, 2.0
        found = least_squares(miss, first, x_scale=self.unit[rough], bounds=(low, high), loss="soft_l1", max_nfev=40)
        start[rough] = found.x
        return start

    def solve(self, dots: Dots, start: NDArray[np.float64]):
        from scipy.optimize import least_squares

        known = np.isfinite(self.deviation)

        def miss(parameters: NDArray) -> NDArray:
            sheet = ((parameters - self.stated) / self.deviation)[known]
            fl, reference = parameters[[NAMES.index("microlens_focal_length_mm"), NAMES.index("reference_mm")]]
            e = self.camera.image_scale
            growth = (fl / reference - e) / PITCH
            return np.concatenate([self.scaled(parameters, dots).ravel(), sheet, [growth]])

        return least_squares(miss, start, x_scale=self.unit, max_nfev=60)

    def scaled(self, parameters: NDArray[np.float64], dots: Dots) -> NDArray[np.float64]:
        """What the dots' images miss the traced ones by, over the standard deviation, (n, 3)."""
        places, model = placed(parameters, dots), self.model(parameters)
        found = images_of(places, model, self.camera, RAYS, dots.aperture_mm).place_mm
        out: NDArray[np.float64] = np.nan_to_num(dots.lens_mm - found, nan=1e3)
        return out / np.hypot(dots.std_mm, FLOOR_MM)

    def in_laboratory(self, parameters: NDArray[np.float64], dots: Dots) -> NDArray[np.float64]:
        """Where the measured images lie in the laboratory less where the dots are, (n, 3)."""
        places, model, step = placed(parameters, dots), self.model(parameters), 1e-3
        at = images_of(places, model, self.camera, RAYS, dots.aperture_mm).place_mm
        jacobian = np.stack(
            [
                (images_of(places + step * unit, model, self.camera, RAYS, dots.aperture_mm).place_mm - at) / step
                for unit in np.eye(3)
            ],
            -1,
        )
        return np.asarray(np.linalg.solve(jacobian, (dots.lens_mm - at)[..., None])[..., 0], np.float64)
