"""Light, seeding and displacement of a recording's first pair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.coverage import middle_with
from plenopiv.checks import filtered, fit, lens_blur, light, motion, static
from plenopiv.checks.findings import Finding
from plenopiv.checks.result import CheckResult
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import printable
from plenopiv.lightfield import LightField, decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.lens_blur import lens_blur as measured_blur
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE, counts_per_electron
from plenopiv.recording import Recording
from plenopiv.sensor import middle_of, without
from plenopiv.volume import VoxelGrid

MIDDLE_PX = 1600  # side of the sensor's middle, in which light, seeding and displacement are measured

Progress = Callable[[str, int, int], None]


def dark_name(recording: Recording) -> str:
    """The name of the dark image, "" without one."""
    return "" if recording.dark_path is None else printable(recording.dark_path.name)


def worst(findings: list[Finding]) -> list[Finding]:
    """Those of several frames that are not good, one for each name, or the first where all are."""
    bad = {finding.name: finding for finding in reversed(findings) if finding.severity != "good"}
    if fit.OTHER_CAMERA in bad:
        bad.pop(fit.MOVED, None)  # half a pitch off, a lattice may seem to fit one of the frames
    return list(bad.values()) or findings[:1]


def light_and_motion(
    recording: Recording,
    seen: CheckResult,
    frames: list[NDArray[np.uint16]],
    names: list[str],
    grid: VoxelGrid,
    correlation: CorrelationSettings,
    report: Progress,
    with_motion: bool,
    blur_measured: bool | None,
) -> tuple[list[Finding], light.Light, motion.Motion | None]:
    """Exposure, background, seeding and displacement, in the sensor's middle; ``frames``: those of the first pair."""
    report("light", 0, 2)
    part = middle_with(seen.camera, grid.limits_mm(), MIDDLE_PX)
    camera = replace(seen.camera, sensor=part)
    unusable = recording.unusable
    where = layout(camera, None if unusable is None else middle_of(unusable, part))
    projector = PlenopticProjector(where, grid, "1-ray")  # only its geometry is used
    gain = NO_WHITE_IMAGE
    if seen.white is not None and seen.lattice is not None:
        of_white = layout(camera.with_lattice(seen.lattice.lattice)) if seen.drift else where
        gain = counts_per_electron(decode(middle_of(seen.white, part), of_white))
    clean: list[NDArray] = list(frames)
    taken = recording.static_light
    if taken is not None:
        clean = [taken.removed(frame, pulse)[0] for pulse, frame in enumerate(frames)]
    fields: list[LightField] = [decode(middle_of(frame, part), where) for frame in clean]
    out: list[Finding] = []
    of_lens = None
    if blur_measured is not None and (blur := measured_blur(fields[0], projector)) is not None:
        of_lens = lens_blur.finding(blur, camera.blur_mm, camera.lattice.pitch_mm, names[0], blur_measured)
        blurred = replace(where, camera=replace(camera, blur_mm=blur.beyond_doubt(camera.lattice.pitch_mm)))
        projector = PlenopticProjector(blurred, grid, "1-ray")  # so that a wider image is no crowd of particles
    dark = dark_name(recording)
    lights = [light.light_of(field, projector, gain) for field in fields]
    frames, clean = ([without(one, unusable, recording.sensor) for one in each] for each in (frames, clean))
    each = [
        light.exposure(frame, recording.sensor, lit, name, dark)
        for frame, lit, name in zip(frames, lights, names, strict=False)
    ]
    if recording.background_of_frames:  # it will be taken off
        each = [[found for found in one if found.name != "background"] for one in each]
    for of_frames in zip(*each, strict=True):
        out += worst(list(of_frames))
    if of_lens is not None and lights[0].signal_to_noise >= light.FAINTEST:
        out.append(of_lens)
    raw = (middle_of(frame, part) for frame in frames)
    often = [filtered.of_frame(image, part, name) for image, name in zip(raw, names, strict=False)]
    out += [one for one in often if one is not None][:1]
    if not any(lit.below_black for lit in lights):  # else little is left of their light
        out.append(static.pulses(*(max(lit.mean - lit.background, 0.0) for lit in lights[:2])))
    if not recording.background_of_frames:
        a, b, of_particles = clean[0], clean[1], (recording.sensor, camera.image_pitch_px, lights[0].particle)
        bright = static.spot(a, b, *of_particles) or static.glow(a, b, seen.white, *of_particles)
        out += [] if bright is None else [bright]
    report("light", 1, 2)
    (lo, hi), last = grid.limits_mm()[2], correlation.windows[-1]
    x, y, z = (n * d for n, d in zip(last, grid.voxel_mm, strict=True))
    out.append(light.seeding(lights[0], camera, hi - lo, (x, y, z)))
    report("light", 2, 2)
    if not with_motion or any(one.name == "underexposed" and one.severity == "unusable" for one in out):
        return out, lights[0], None
    report("displacement", 0, 1)
    moved = motion.motion(fields[0], fields[1], (lo, hi))
    limit = correlation.search * np.array(correlation.windows[0], float)
    out.append(motion.finding(moved, grid.voxel_mm, limit))
    report("displacement", 1, 1)
    return out, lights[0], moved
