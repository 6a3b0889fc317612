"""The experiment file that ``plenopiv init`` drafts: every key with its meaning and unit."""

from __future__ import annotations

import json
import re
from typing import Any

BEFORE_COMMENT = "\t# "  # TOML's texts hold no tabs
COMMENTS_AT = 33  # column of the comments, where values are short enough

TEMPLATE = """\
# One plenoptic recording, from raw images to a velocity field:  plenopiv run experiment.toml
# Paths are relative to this file. Lengths in mm, times in s, as every key says.
# Frame: z = 0 is the focal plane, +z points toward the camera, x right and y up as the camera sees.

[camera]
kind = "plenoptic"

[camera.main_lens]
focal_length_mm = {focal_length}
aperture_mm = {aperture}   # or f_number = focal_length / aperture, as engraved on the lens
magnification = {magnification}   # negative: the image is inverted

[camera.microlens_array]
lattice = {lattice}   # "hexagonal" or "square"
pitch_mm = {pitch}   # between microlenses; their images are a little farther apart
focal_length_mm = {microlens_focal_length}

[camera.sensor]
columns = {columns}
rows = {rows}
pixel_pitch_mm = {pixel_pitch}
bit_depth = {bit_depth}   # of the counts in the files, which may hold 12 bits in 16
black_level = {black_level}   # counts of a pixel without light

[recording]
{images}
dt_s = {dt}   # {what_dt}
orientation = {orientation}   # columns grow with +x, rows with -y; "sensor" = as the inverted image falls

[volume]   # outer faces; parts that some views miss are reconstructed worse
x_mm = {x}   # what every view sees at the ends of z_mm
y_mm = {y}
z_mm = {z}   # {why_depth}
voxel_mm = {voxel}   # along x, y, z

[reconstruction]
method = {method}   # "mart": every voxel may hold light; "drt-mart": only those that can hold a particle
iterations = {iterations}   # each uses all views once
relaxation = {relaxation}   # 0 to 1: smaller is steadier and slower

[correlation]
windows = {windows}   # voxels along x, y, z, coarse to fine
overlap = {overlap}   # of neighbouring windows, as a fraction
# inner_window = {inner}   # default; sub-windows, whose vectors are averaged; smaller for curved flows

[output]
directory = "results"
"""


def filled(**values: Any) -> str:
    """The template with values as TOML writes them, comments in one column."""
    lines = TEMPLATE.replace("   # ", BEFORE_COMMENT).format(**values).split("\n")  # file names may hold anything else
    return "\n".join(re.sub(rf"^(\S.*?){BEFORE_COMMENT}", _aligned, line) for line in lines)


def toml(value: Any) -> str:
    """Text, or nested lists of it, as TOML has them."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _aligned(match: re.Match) -> str:
    return f"{match[1]:<{COMMENTS_AT - 2}}  # "
