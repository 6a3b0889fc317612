"""The paper's Figs. 1, 2 and 8 drawn anew: the camera, one ray through it, and the principle of DRT:  schematics.py

The paper's Fig. 1 is a drawing of its prototype; here it is the same camera in section, distances to scale. In the
other two the microlenses are fifty times as large as the camera's (``LARGE``), or none would be seen; each ray goes
where the equations send it (``plenopiv.optics``). Writes fig01-camera.png, fig02-ray.png and fig08-drt.png.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle
from outputs import command_line, write_picture
from small_camera import CAMERA

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.optics import scale, spread
from plenopiv.report.figures import BLUE, INK, ORANGE, STYLE
from plenopiv.sensor import Sensor

PITCH_MM, PIXELS, LENSES = 3.85, 7, 7  # of the camera with large microlenses
MATCHED_MM = CAMERA.main_lens.image_distance_mm / CAMERA.main_lens.aperture_mm  # focal length over pitch
LARGE = replace(
    CAMERA,
    lattice=Lattice("square", PITCH_MM),
    microlens_focal_length_mm=PITCH_MM * MATCHED_MM,
    sensor=Sensor(2 * PIXELS * LENSES, 2 * PIXELS * LENSES, PITCH_MM / PIXELS, 12),
)
GREY = "#8a939c"
OF_RAY_MM, V_MM = (22.0, 4.0), 8.0  # z and y of the particle of Fig. 2, and where its ray meets the main lens
OF_VOXEL_MM = (26.0, 1.5)  # z and y of the voxel of Fig. 8
REPRESENTATIVE = 3  # rays of a portion of the main lens, of the nine in three dimensions


@dataclass(frozen=True)
class Ray:
    """Where a ray of the y-z plane crosses the main lens, the microlens plane and the sensor, and the centre of its
    microlens there; mm from the optical axis."""

    v: float
    t: float
    lens: float
    sensor: float


def ray_of(camera: PlenopticCamera, y_mm: float, z_mm: float, v_mm: float) -> Ray:
    """The ray from (y, z) that crosses the main lens at v."""
    lens, pitch, e = camera.main_lens, camera.lattice.pitch_mm, camera.image_scale
    far = lens.object_distance_mm, lens.image_distance_mm
    t = float(spread(z_mm, *far, lens.focal_length_mm) * v_mm + scale(z_mm, *far) * y_mm)
    centre = pitch * round(t / pitch)
    return Ray(v_mm, t, centre, centre * (1.0 + e) + e * ((t - centre) - v_mm))


def planes(camera: PlenopticCamera) -> tuple[float, float, float]:
    """Where main lens, microlenses and sensor stand, mm beyond the focal plane."""
    lens = camera.main_lens
    first = lens.object_distance_mm
    return first, first + lens.image_distance_mm, first + lens.image_distance_mm + camera.microlens_focal_length_mm


def draw_ray(ax: Axes, camera: PlenopticCamera, y_mm: float, z_mm: float, ray: Ray, colour: str, width: float) -> None:
    """A ray from its source to the sensor."""
    ax.plot([z_mm, *planes(camera)], [y_mm, ray.v, ray.t, ray.sensor], color=colour, lw=width, zorder=3)


def draw_camera(ax: Axes, camera: PlenopticCamera, lenses: int) -> None:
    """Focal plane, main lens, microlenses and pixels in the y-z plane."""
    main, mla, sensor = planes(camera)
    half, pitch = 0.5 * camera.main_lens.aperture_mm, camera.lattice.pitch_mm
    ax.axhline(0.0, color=GREY, lw=0.6, ls=(0, (8, 3, 1, 3)), zorder=1)
    ax.plot([0, 0], [-half, half], color=GREY, lw=1.0, ls="--")
    ax.add_patch(Ellipse((main, 0.0), 0.16 * half, 2.0 * half, fc="#dce8f2", ec=BLUE, lw=1.0, zorder=2))
    for k in range(-(lenses // 2), lenses // 2 + 1):
        ax.add_patch(Ellipse((mla, k * pitch), 0.3 * pitch, pitch, fc="#dce8f2", ec=BLUE, lw=0.8, zorder=2))
    size = camera.sensor.pixel_pitch_mm
    rows = 2 * int(0.5 * lenses * pitch * (1.0 + camera.image_scale) / size) + 1
    for row in range(rows):
        low = (row - 0.5 * rows) * size
        ax.add_patch(Rectangle((sensor, low), 2.0, size, fc="white", ec=GREY, lw=0.4, zorder=2))
    ax.set(xlabel="distance from the focal plane, toward the camera, mm", ylabel="y, mm")


def named(ax: Axes, words: str, at: tuple[float, float], side: str = "center") -> None:
    """A word beside what it names."""
    ax.text(*at, words, ha=side, va="center", color=INK, fontsize=9, zorder=5)


def measured(ax: Axes, words: str, begin: float, end: float, at: float) -> None:
    """A distance along the axis between two places."""
    ax.annotate("", (begin, at), (end, at), arrowprops={"arrowstyle": "<->", "color": INK, "lw": 0.8})
    ax.text(0.5 * (begin + end), at + 0.7, words, ha="center", color=INK, fontsize=9)


@rc_context(STYLE)
def camera_in_section() -> Figure:
    """Fig. 1: the paper's camera, and four of its microlenses; both to scale."""
    figure = Figure(figsize=(10.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
    main, mla, sensor = planes(CAMERA)
    lens, half = CAMERA.main_lens, 0.5 * CAMERA.main_lens.aperture_mm
    left.add_patch(Rectangle((main - 12, -20), 60, 40, fc="#f3f4f6", ec=GREY, lw=1.0, zorder=0))
    left.add_patch(Rectangle((main + 48, -26), mla - main - 32, 52, fc="#e7eaee", ec=GREY, lw=1.0, zorder=0))
    left.axhline(0.0, color=GREY, lw=0.6, ls=(0, (8, 3, 1, 3)))
    left.plot([0, 0], [-half, half], color=GREY, lw=1.0, ls="--")
    left.add_patch(Ellipse((main, 0.0), 3.0, 2.0 * half, fc="#dce8f2", ec=BLUE, lw=1.0, zorder=2))
    left.plot([mla, mla], [-10.05, 10.05], color=BLUE, lw=2.0)
    left.plot([sensor + 0.7, sensor + 0.7], [-12.1, 12.1], color=INK, lw=2.0)
    for v in (-half, half):
        left.plot([0, main, mla], [0, v, 0], color=ORANGE, lw=0.8)
    for words, at in {
        "focal plane": (0, half + 4), "main lens": (main, half + 4), "lens mount": (main + 10, -23.5),
        "camera body": (main + 80, -23), "microlenses,\nsensor": (mla - 13, 17),
    }.items():  # fmt: skip
        named(left, words, at)
    measured(left, f"$S_o$ = {lens.object_distance_mm:g} mm", 0, main, -17)
    measured(left, f"$S_i$ = {lens.image_distance_mm:g} mm", main, mla, -17)
    left.set(xlabel="distance from the focal plane, mm", ylabel="y, mm", xlim=(-12, sensor + 22), ylim=(-29, 29))
    pitch, focal, e = CAMERA.lattice.pitch_mm, CAMERA.microlens_focal_length_mm, CAMERA.image_scale
    for k in range(-2, 3):
        right.add_patch(Ellipse((0.0, 1e3 * k * pitch), 24, 1e3 * pitch, fc="#dce8f2", ec=BLUE, lw=0.9))
        for u in (-half, half):
            end = k * pitch * (1 + e) - e * u
            right.plot([0, 1e3 * focal], [1e3 * k * pitch, 1e3 * end], color=ORANGE, lw=0.6)
    size = 1e3 * CAMERA.sensor.pixel_pitch_mm
    for row in range(-35, 36):
        right.add_patch(Rectangle((1e3 * focal, (row - 0.5) * size), 10, size, fc="white", ec=GREY, lw=0.4))
    named(right, f"pitch {1e3 * pitch:g} um", (52, 230), "left")
    named(right, f"$f_l$ = {1e3 * focal:g} um;\npixels of {size:g} um", (52, -232), "left")
    right.set(xlim=(-30, 340), ylim=(-270, 270), xlabel="behind the microlenses, um", ylabel="um")
    right.set_title("microlenses and sensor")
    left.set_title("the camera in section")
    return figure


@rc_context(STYLE)
def one_ray() -> Figure:
    """Fig. 2: a ray from a particle to its pixel."""
    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    ax = figure.subplots()
    draw_camera(ax, LARGE, LENSES)
    z, y = OF_RAY_MM
    ray, (main, mla, sensor) = ray_of(LARGE, y, z, V_MM), planes(LARGE)
    draw_ray(ax, LARGE, y, z, ray, ORANGE, 1.6)
    ax.plot(z, y, "o", color=ORANGE, ms=6)
    lens = LARGE.main_lens
    measured(ax, f"$S_o$ = {lens.object_distance_mm:g} mm", 0, main, -16.5)
    measured(ax, f"$S_i$ = {lens.image_distance_mm:g} mm", main, mla, -16.5)
    measured(ax, "$f_l$", mla, sensor, -16.5)
    measured(ax, "z", 0, z, -8)
    for words, at, side in (
        ("particle (y, z)", (z, y + 2.2), "center"), ("focal plane", (0, 14.3), "center"),
        ("main lens, aperture $P_m$", (main, 14.3), "center"), ("v", (main + 2, ray.v + 1.6), "left"),
        ("microlenses, pitch $p_l$", (mla - 3, 15.8), "right"), ("t", (mla - 2.5, ray.t + 1.3), "right"),
        ("sensor, pixels of $p_p$", (sensor + 3.5, 15.8), "left"), ("pixel", (sensor + 3.5, ray.sensor), "left"),
    ):  # fmt: skip
        named(ax, words, at, side)
    ax.set(xlim=(-12, sensor + 45), ylim=(-19, 18))
    return figure


@rc_context(STYLE)
def principle_of_drt() -> Figure:
    """Fig. 8: representative rays of a voxel find the microlenses, and so the pixels, that its light reaches."""
    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    ax = figure.subplots()
    draw_camera(ax, LARGE, LENSES)
    z, y = OF_VOXEL_MM
    main_lens, mla, sensor = planes(LARGE)
    for rays in portions(LARGE, y, z):
        for ray in rays:
            middle = ray is rays[len(rays) // 2]
            draw_ray(ax, LARGE, y, z, ray, ORANGE if middle else GREY, 0.9 if middle else 0.5)
            low = LARGE.sensor.pixel_pitch_mm * (np.floor(ray.sensor / LARGE.sensor.pixel_pitch_mm + 0.5) - 0.5)
            ax.add_patch(
                Rectangle((sensor, low), 2.0, LARGE.sensor.pixel_pitch_mm, fc=ORANGE, ec=GREY, lw=0.4, zorder=4)
            )
    ax.add_patch(Rectangle((z - 1.2, y - 0.6), 2.4, 1.2, fc="#c0392b", ec=INK, lw=0.6, zorder=5))
    for words, at, side in (
        ("voxel", (z, y + 2.4), "center"), ("focal plane", (0, 14.3), "center"),
        (f"main lens, {PIXELS} portions", (main_lens, 14.3), "center"),
        ("microlenses", (mla - 3, 15.8), "right"), ("affected pixels", (sensor + 3.5, 15.8), "left"),
    ):  # fmt: skip
        named(ax, words, at, side)
    measured(ax, "dz", 0, z, -8)
    ax.set(xlim=(-12, sensor + 30), ylim=(-17, 18))
    return figure


def portions(camera: PlenopticCamera, y_mm: float, z_mm: float) -> list[list[Ray]]:
    """Of each portion of the main lens, which one pixel sees through every microlens, its edges' and middle rays."""
    edges = np.linspace(-0.5, 0.5, PIXELS + 1) * camera.main_lens.aperture_mm
    inside = np.linspace(0.02, 0.98, REPRESENTATIVE)  # a ray on an edge belongs to two
    return [
        [ray_of(camera, y_mm, z_mm, float(low + share * (high - low))) for share in inside]
        for low, high in pairwise(edges)
    ]


def main(out: Path, _reduced: bool) -> None:
    """Draw all three."""
    for name, drawn in (("fig01-camera", camera_in_section), ("fig02-ray", one_ray), ("fig08-drt", principle_of_drt)):
        write_picture(out, name, drawn(), 110)


if __name__ == "__main__":
    command_line(main, __doc__)
