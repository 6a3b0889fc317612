"""Refocusing reads every pixel where its own portion of the main lens looks from.

A scene of one plane at depth z whose light is a linear function of x and y is read without error by linear
interpolation, so that a refocused picture of it is that function. Where each pixel looks is worked out from its place
on the sensor: a microlens S images the main lens onto S (1 + e) - e u, and the ray from u through S meets the plane at
(S - A u)/B.
"""

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import LightField, layout
from plenopiv.refocusing import image_axes, refocused

CAMERAS = {
    "square": small_camera("square", pmr=14.04, microlenses=(15, 13), magnification=-0.5, offset_mm=(0.002, 0.001)),
    "turned": small_camera("square", pmr=14.04, microlenses=(15, 13), magnification=-0.5, rotation_rad=0.002),
    "hexagonal": small_camera("hexagonal", pmr=14.04, microlenses=(15, 13), magnification=-0.5, offset_mm=(0.002, 0.0)),
}
LAYOUTS = {name: layout(camera) for name, camera in CAMERAS.items()}


def seen_of(where, z_mm, slope):
    """The light field of the plane z whose counts in a wholly lit pixel are 1000 + slope . (x, y)."""
    camera = where.camera
    e, a, b = camera.image_scale, float(camera.spread(z_mm)), float(camera.scale(z_mm))
    j, i = np.mgrid[where.j0 : where.j0 + where.nj, where.i0 : where.i0 + where.ni]
    lens = np.stack(camera.lattice.centres(i.ravel(), j.ravel()), -1)
    pixel = where.pixel[None] + where.offsets[:, None]
    on_sensor = np.stack(camera.sensor.plane_from_pixel(pixel[..., 0], pixel[..., 1]), -1)
    on_main_lens = (lens * (1 + e) - on_sensor) / e
    place = (lens - a * on_main_lens) / b
    values = (1000.0 + place @ slope) * where.fill * where.seen
    return LightField(where, values.astype(np.float32))


@pytest.mark.parametrize("z_mm", [-6.0, 4.0])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("where", LAYOUTS.values(), ids=LAYOUTS)
def test_a_slope_is_where_it_is(where, axis, z_mm):
    """To a quarter of what a pixel's largest phase moves it by at that depth: half a portion of the main lens."""
    camera = where.camera
    slope = np.zeros(2)
    slope[axis] = 50.0
    x, y = (v[3:-3] for v in image_axes(camera))
    picture = refocused(seen_of(where, z_mm, slope), z_mm, x, y)
    found = (picture - 1000.0) / slope[axis] - (x[None, :] if axis == 0 else y[:, None])
    half_portion = 0.5 * camera.portion_mm * abs(float(camera.spread(z_mm)) / float(camera.scale(z_mm)))
    print(f"\noff by {np.abs(found).max():.1e} mm, half a portion {half_portion:.1e} mm")
    assert np.abs(where.phase[:, axis]).max() > 0.3
    assert np.abs(found).max() < 0.25 * half_portion
