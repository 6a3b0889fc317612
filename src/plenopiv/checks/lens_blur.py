"""Whether the main lens is as sharp as the experiment file says, from the particles of one frame."""

from __future__ import annotations

from math import floor, log10

from plenopiv.checks.findings import Finding
from plenopiv.reconstruction.lens_blur import LensBlur

NAME = "main-lens-blur"
OFF = 0.25  # of the blur found, by which the stated one may be another
KEY = "camera.main_lens.blur_mm"


def finding(found: LensBlur, stated_mm: float, pitch_mm: float, name: str, measured: bool = False) -> Finding:
    """The blur ``found`` in the frame ``name`` against the stated one. ``measured``: a run measures it itself."""
    blur = found.beyond_doubt(pitch_mm)
    bound, um = found.least_mm(pitch_mm), 1e3 * blur
    if blur == 0 and (stated_mm <= bound or measured):
        words = f"the main lens is sharp: {name} shows no blur beyond {1e3 * bound:.0f} um at the microlenses"
        return Finding(NAME, "good", words, 0.0, "um")
    found_words = f"the main lens blurs: its point spread in {name} has a standard deviation of {um:.0f} um"
    found_words += f" at the microlenses, {blur / pitch_mm:.2f} pitches"
    if measured or (blur > 0 and abs(stated_mm - blur) <= max(OFF * blur, bound)):
        return Finding(NAME, "good", found_words + ", which a run takes into account", um, "um")
    if blur == 0:
        words = f"the main lens is sharp in {name}; {KEY} = {stated_mm:g} states a blur"
        return Finding(NAME, "warning", words, um, "um", f'set {KEY} = 0, or "auto"')
    more = "" if stated_mm == 0 else f", not the stated {1e3 * stated_mm:.0f} um"
    advice = f'set {KEY} = {_rounded(blur):g}, or "auto", and vectors are measured with it; is the focus on z = 0?'
    return Finding(NAME, "warning", found_words + more, um, "um", advice)


def _rounded(value: float) -> float:
    """To two digits."""
    return round(value, 1 - floor(log10(value))) if value > 0 else 0.0
