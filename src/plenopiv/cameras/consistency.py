"""Whether the numbers of a camera go together."""

from __future__ import annotations

from plenopiv.cameras.plenoptic import PlenopticCamera

MATCHED = 0.02  # by which f-numbers may differ, relative
FASTEST = 0.5  # f-number that no lens in air falls below: its rays would leave the sensor's half space (sine condition)
OVERFILL = 4.0  # micro-images so many pitches wide have hardly a pixel that one lens alone lights


def contradictions(camera: PlenopticCamera) -> list[str]:
    """Reasons why the numbers cannot be those of one focused plenoptic camera; a line each, its key first."""
    lens, pitch, focal = camera.main_lens, camera.lattice.pitch_mm, camera.microlens_focal_length_mm
    pixel, sensor = camera.sensor.pixel_pitch_mm, camera.sensor
    lines = []
    if pitch < 2 * pixel:
        lines.append(f"microlens_array.pitch_mm: {pitch:g} mm is under two pixels of {pixel:g} mm; are both in mm?")
    if 4 * pitch > pixel * min(sensor.columns, sensor.rows):
        lines.append(
            f"microlens_array.pitch_mm: fewer than four microlenses of {pitch:g} mm fit on the sensor; is it in mm?"
        )
    if focal >= lens.image_distance_mm:
        lines.append(
            f"microlens_array.focal_length_mm: {focal:g} mm is not below the main lens' image distance, "
            f"{lens.image_distance_mm:.4g} mm; is it in mm?"
        )
    if lens.aperture_mm * FASTEST > lens.focal_length_mm:
        lines.append(
            f"main_lens: an aperture of {lens.aperture_mm:g} mm at a focal length of {lens.focal_length_mm:g} mm is "
            f"f/{lens.focal_length_mm / lens.aperture_mm:.2g}, and no lens is faster than f/{FASTEST:g}; is it in mm?"
        )
    elif lens.aperture_mm > OVERFILL * camera.matched_aperture_mm:
        lines.append(
            f"main_lens: an aperture of {lens.aperture_mm:g} mm makes micro-images "
            f"{lens.aperture_mm / camera.matched_aperture_mm:.3g} times as wide as their pitch; at "
            f"{camera.matched_aperture_mm:.4g} mm they just touch"
        )
    if lens.aperture_mm * abs(lens.magnification) <= pitch:
        lines.append(
            f"main_lens: an aperture of {lens.aperture_mm:g} mm at magnification {lens.magnification:g} leaves no "
            f"parallax beyond one microlens; is it in mm?"
        )
    return lines


def mismatch(camera: PlenopticCamera) -> str | None:
    """How the main lens over- or underfills the microlenses, in a line; None where f-numbers match to 2 %."""
    lens = camera.main_lens
    image_side = lens.image_distance_mm / lens.aperture_mm
    microlens = camera.microlens_focal_length_mm / camera.lattice.pitch_mm
    if abs(image_side / microlens - 1.0) <= MATCHED:
        return None
    effect = "overlap" if image_side < microlens else "leave pixels between them dark"
    return (
        f"f-numbers do not match: main lens f/{image_side:.3g} on the image side (S_i/P_m), microlenses "
        f"f/{microlens:.3g} (f_l/p_l), so micro-images {effect}; matched at an aperture of "
        f"{camera.matched_aperture_mm:.4g} mm"
    )
