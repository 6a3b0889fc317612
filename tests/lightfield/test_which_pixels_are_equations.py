"""Which pixels a light field takes: at least half lit by their own microlens, and by no other.

Asked of the geometry alone, pixel by pixel: under the microlens S the aperture's image is a disc of radius e P_m/2
whose centre is S (1 + e) + e (s - S) for light that meets the microlens at s.
"""

from math import cos, pi, sin

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.light import disc_rectangle_area

from plenopiv.lightfield import disc_share, layout

CAMERAS = {
    "square": small_camera("square", pmr=14.0, microlenses=(9, 7), rotation_rad=0.002),
    "square-turned": small_camera("square", pmr=8.0, microlenses=(9, 7), rotation_rad=0.015),
    "hexagonal": small_camera("hexagonal", pmr=14.04, microlenses=(9, 7), rotation_rad=0.017, offset_mm=(0.01, 0.02)),
    "hexagonal-8": small_camera("hexagonal", pmr=8.0, microlenses=(9, 7), rotation_rad=-0.01),
}
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def lit_by(camera, lens, column, row, grown_px=0.0):
    """Share of a pixel that light through the middle of lens (i, j) reaches; ``grown_px`` more of a radius."""
    e, p = camera.image_scale, camera.sensor.pixel_pitch_mm
    s, t = (float(c) for c in camera.lattice.centres(*lens))
    column0, row0 = camera.sensor.axis
    x, y = column - (column0 - s * (1 + e) / p), row - (row0 + t * (1 + e) / p)
    radius = 0.5 * camera.main_lens.aperture_mm * e / p + grown_px
    return disc_rectangle_area(x - 0.5, x + 0.5, y - 0.5, y + 0.5, radius)


def most_lit_by(camera, lens, column, row):
    """The most of a pixel that light through a lens reaches, wherever within half a pitch it meets it."""
    move = 0.5 * camera.lattice.pitch_mm * camera.image_scale / camera.sensor.pixel_pitch_mm  # px
    moved = [(move * cos(k * pi / 6), move * sin(k * pi / 6)) for k in range(12)]
    return max(lit_by(camera, lens, column - dx, row - dy) for dx, dy in moved)


@every_camera
def test_half_lit_by_its_own_lens_and_by_no_other(camera):
    """Of a share of half upward every pixel counts, unless a neighbour lights more than a thousandth of it."""
    where, sensor = layout(camera), camera.sensor
    camera, wrong = where.camera, []
    reach = int(camera.aperture_radius_px) + 2
    beside = [(a, b) for a in range(-3, 4) for b in range(-3, 4) if 0 < abs(a) + abs(b) <= 3]
    in_the_middle = np.flatnonzero((np.abs(where.pixel - sensor.axis) < 1.6 * camera.image_pitch_px).all(1))[::2]
    for lens in in_the_middle:
        own = where.i0 + lens % where.ni, where.j0 + lens // where.ni
        others = [(own[0] + a, own[1] + b) for a, b in beside]
        seen = {tuple(where.pixel[lens] + where.offsets[v]) for v in np.flatnonzero(where.seen[:, lens])}
        for n, m in np.ndindex(2 * reach + 1, 2 * reach + 1):
            place = column, row = tuple(where.pixel[lens] + (m - reach, n - reach))
            lit = lit_by(camera, own, column, row)
            if place in seen and lit < 0.499:
                wrong.append((place, lit, "is too dark"))
            elif place in seen and np.hypot(m - reach, n - reach) > reach - 4:
                foreign = sum(most_lit_by(camera, other, column, row) for other in others)
                if foreign > 0.0012:
                    wrong.append((place, foreign, "is lit by another lens"))
            elif (
                place not in seen
                and lit > 0.501
                and not any(lit_by(camera, other, column, row, grown_px=0.1) for other in others)
            ):
                wrong.append((place, lit, "is left out"))
    assert len(in_the_middle) >= 4
    assert not wrong


@pytest.mark.parametrize(("x", "y", "radius"), [(2.5, 3.5, 5.0), (4.5, 11.5, 13.0), (0.0, 0.0, 0.5**0.5)])
def test_a_pixel_whose_corner_is_on_the_rim_is_wholly_lit(x, y, radius):
    """Far corners (3, 4), (5, 12) and (1/2, 1/2)."""
    for a, b in ((x, y), (y, x), (-x, y), (x, -y)):
        assert disc_share(np.array([a]), np.array([b]), radius) == [1.0]
