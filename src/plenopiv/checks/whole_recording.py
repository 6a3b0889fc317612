"""All checks on one recording."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.drift import find_drift, light_of
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.checks import at_rest, drift, fit, missing, outlines, repeats, reversal, stamps, static, white
from plenopiv.checks.findings import Finding
from plenopiv.checks.first_pair import MIDDLE_PX, Progress, dark_name, light_and_motion, worst
from plenopiv.checks.result import CheckResult
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning, printable
from plenopiv.recording import Recording
from plenopiv.sensor import middle, middle_of, without
from plenopiv.volume import VoxelGrid

PAIRS = 8  # whose first frames are searched for common light


def check(
    recording: Recording,
    camera: PlenopticCamera,
    grid: VoxelGrid,
    correlation: CorrelationSettings,
    progress: Progress | None = None,
    *,
    with_motion: bool = True,
    stated: bool = True,
    blur_measured: bool | None = False,
    drift_measured: bool = False,
) -> CheckResult:
    """Check a recording: files, white image, frames against it, light, seeding, displacement.

    ``camera`` as it is stated, ``grid`` and ``correlation`` as a run would take them. ``progress(stage, done, total)``.
    ``with_motion``: the displacement too, which takes longest and which a run measures itself. ``stated``: the stated
    aperture is used, not that of a calibration with a target. ``blur_measured``: the main lens' blur is not stated, a
    run measures it; None: it is not looked for. ``drift_measured``: a run follows microlenses that have moved since the
    white image.

    Raises:
        PlenoPIVError: the white image cannot be read, or no pair of frames.
    """
    report = progress or (lambda stage, done, total: None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)  # saturation is a finding here
        chosen, findings = readable(recording)
        frames = [recording.frame(k) for k in chosen]
        image = recording.white()
    names = [printable(recording.frames[k].name) for k in chosen]
    findings += _files(recording)
    if recording.static_light is not None:
        findings += static.of_files(recording.static_light, dark_name(recording))
    elif not recording.background_of_frames:
        findings += _common_light(recording)
    seen = CheckResult((), camera, names[0], frames[0], image)
    if image is not None:
        report("white image", 0, 1)
        name = printable(recording.white_path.name)  # type: ignore[union-attr]
        largest = max(float(frame.max()) for frame in frames)
        of_white, found = white.white_image(image, camera, name, stated, largest, recording.white_path)
        findings += of_white
        report("white image", 1, 1)
        if found is None:
            return replace(seen, findings=tuple(findings))
        seen = replace(seen, camera=camera.with_lattice(found.lattice), lattice=found)
        taken_off = recording.static_light is not None or recording.background_of_frames
        if not taken_off and "static-light" not in [finding.name for finding in findings]:
            findings += _at_rest(recording, seen.camera, image)
        report("frames against the white image", 0, 1)
        seen, of_frames = _against_white(recording, seen, chosen, frames, names, drift_measured)
        findings += of_frames
        report("frames against the white image", 1, 1)
        if any(finding.severity == "unusable" for finding in findings if finding.name in ("flipped", fit.OTHER_CAMERA)):
            return replace(seen, findings=tuple(findings))
    how = report, with_motion, blur_measured
    others, lit, moved = light_and_motion(recording, seen, frames[:2], names, grid, correlation, *how)
    if not any(finding.name == "underexposed" and finding.severity == "unusable" for finding in others):
        findings = _with_reversal(findings, recording, seen.camera, grid)
    return replace(seen, findings=tuple(findings + others), light=lit, motion=moved)


def readable(recording: Recording) -> tuple[list[int], list[Finding]]:
    """Numbers of the frames that are checked, those of the first pair and the last one, passing over what cannot be
    read, and a finding on that.

    Raises:
        PlenoPIVError: no pair can be read.
    """
    pair, bad = recording.first_readable_pair()
    last, more_bad = recording.last_readable_pair()
    bad |= more_bad
    out = []
    if bad:
        more = f" ({len(bad)} such frames)" if bad.keys() - {next(iter(bad))} else ""
        advice = "copy the file again; a run sets its pairs aside"
        out = [Finding("damaged-frame", "warning", next(iter(bad.values())) + more, float(len(bad)), "frames", advice)]
    return sorted({*pair, last[1]}), out


def _against_white(
    recording: Recording, seen: CheckResult, chosen: list[int], frames: list[NDArray], names: list[str], drifts: bool
) -> tuple[CheckResult, list[Finding]]:
    """How ``frames``, of numbers ``chosen``, lie to the white image, where the array has drifted to it as it would be
    now, and findings on that."""
    white, camera = seen.white, seen.camera
    assert white is not None
    level = camera.sensor.black_level

    def compared(with_white: NDArray, lattice_of: PlenopticCamera) -> tuple[CheckResult, list[Finding]]:
        fits, found = outlines.compared(frames, names, with_white, lattice_of, recording.unusable)
        return replace(seen, fit=fits[0]), worst(found)

    as_it_was, found = compared(white, camera)
    if not drifts or any(finding.name == "flipped" for finding in found):
        return as_it_was, found
    moved = find_drift(light_of(recording, chosen), white - np.float32(level), camera, recording.unusable)
    if moved is None or (of_drift := drift.finding(moved, camera.sensor)) is None:
        return as_it_was, found
    now, found = compared(moved.drift.moved(white), moved.drift.of(camera))
    if any(finding.severity == "unusable" for finding in found):
        return as_it_was, found
    return replace(now, camera=moved.drift.of(camera), drift=moved), [*found, of_drift]


def _files(recording: Recording) -> list[Finding]:
    """Findings on times and cameras in the files, on names of pairs, and on frames that are one image."""
    unknown = stamps.Stamp(None, {})
    marks = [
        (printable(frame.name), unknown if k in recording.damaged else stamps.stamp(frame))
        for k, frame in enumerate(recording.frames)
    ]
    out = [stamps.in_order(marks, recording.dt_s, () if recording.is_sequence else recording.pairs)]
    out += [found for found in (reversal.of_names(recording), missing.of_names(recording)) if found]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        out += repeats.findings(recording)
    if recording.white_source is not None:
        white = recording.white_source
        other = stamps.same_camera(marks[0], (printable(white.name), stamps.stamp(white)))
        out += [other] if other else []
    sources = [frame for k, frame in enumerate(recording.frames) if k not in recording.damaged][:1]
    sources += [recording.white_source] if recording.white_source is not None else []
    turned = stamps.turned([(printable(source.name), stamps.orientation(source)) for source in sources])
    out += [turned] if turned else []
    return out


def _with_reversal(
    findings: list[Finding], recording: Recording, camera: PlenopticCamera, grid: VoxelGrid
) -> list[Finding]:
    """The findings with what the frames say of their order; where they move evenly, names of pairs are a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        try:
            found = reversal.of_frames(recording, camera, grid.limits_mm()[2])
        except PlenoPIVError:  # a damaged frame is a finding of its own
            return findings
    if found is None:
        return findings
    even = found.severity == "good"
    by_name = reversal.of_names(recording)
    return [replace(f, severity="warning") if even and f == by_name else f for f in findings] + [found]


def _common_light(recording: Recording) -> list[Finding]:
    """Light that the first frames of pairs share, in the sensor's middle; nothing in a sequence, where particles of
    successive frames overlap."""
    if recording.is_sequence:
        return []
    sensor, unusable = recording.sensor, recording.unusable
    if unusable is not None:
        unusable = middle_of(unusable, middle(sensor, MIDDLE_PX, MIDDLE_PX))
    found = static.common_light([without(frame, unusable, sensor) for frame in _first_frames(recording)], sensor)
    return [] if found is None else [found]


def _frame(recording: Recording, k: int) -> NDArray[np.uint16] | None:
    """A frame, None where it cannot be read."""
    try:
        return recording.frame(k)
    except PlenoPIVError:
        return None


def _at_rest(recording: Recording, camera: PlenopticCamera, white: NDArray) -> list[Finding]:
    """The same by correlation with a ``white`` image, for which two pairs are enough."""
    if recording.is_sequence:
        return []
    frames = _first_frames(recording)
    if len(frames) < 2:
        return []
    part = middle(recording.sensor, MIDDLE_PX, MIDDLE_PX)
    found = at_rest.finding(at_rest.in_common(frames, middle_of(white, part), camera))
    return [] if found is None else [found]


def _first_frames(recording: Recording) -> list[NDArray]:
    """First frames of some pairs, spread over the recording, the sensor's middle."""
    part, count = middle(recording.sensor, MIDDLE_PX, MIDDLE_PX), len(recording.pairs)
    chosen = sorted({round(k) for k in np.linspace(0, count - 1, min(count, PAIRS))})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        frames = [
            middle_of(frame, part) for k in chosen if (frame := _frame(recording, recording.pairs[k][0])) is not None
        ]
    return frames
