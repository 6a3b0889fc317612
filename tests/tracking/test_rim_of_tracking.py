"""Pixels that the main lens' rim clips are no equations of the fit: against the share of light that it leaves."""

from dataclasses import replace

import numpy as np
from particle_scenes import CAMERA

from plenopiv.cameras.plenoptic import LensRim
from plenopiv.lightfield import rim_share
from plenopiv.tracking.rim import clipped_by_rim

RADIUS_MM = 0.5 * CAMERA.main_lens.aperture_mm
CLIPPING = replace(CAMERA, rim=LensRim(1.02 * RADIUS_MM, -4.0, (0.3, -0.2)))  # slips by 2.4 mm to the sensor's edge


def left_by_rim(camera):
    """Of each pixel of the sensor, of its nearest microlens: the share of light that the rim leaves, and how far from
    the middle of the micro-image it is (px)."""
    sensor, whole = camera.sensor, 1.0 + camera.image_scale
    column, row = np.meshgrid(np.arange(sensor.columns), np.arange(sensor.rows))
    column0, row0 = sensor.axis
    pitch = sensor.pixel_pitch_mm
    s, t = camera.lattice.centres(
        *camera.lattice.nearest((column0 - column) * pitch / whole, (row - row0) * pitch / whole)
    )
    x, y = column - (column0 - s * whole / pitch), row - (row0 + t * whole / pitch)
    return rim_share(camera, x, y, s, t), np.hypot(x, y)


def test_clipped_pixels_are_named_and_few_others():
    clipped, (left, away) = clipped_by_rim(CLIPPING), left_by_rim(CLIPPING)
    within = away < CLIPPING.aperture_radius_px
    assert (left[within] < 0.5).mean() > 0.03
    assert clipped[within & (left < 0.9)].mean() > 0.98
    assert not clipped[within & (left > 0.999) & (away < CLIPPING.aperture_radius_px - 3)].any()
    assert clipped.mean() < 2.5 * (left < 0.9).mean()


def test_no_rim_and_a_wide_one_clip_nothing():
    assert clipped_by_rim(CAMERA) is None
    assert clipped_by_rim(replace(CAMERA, rim=LensRim(3 * RADIUS_MM, -4.0, (0.3, -0.2)))) is None
