"""The key ``main_lens.blur_mm``: a number, or "auto"."""

from __future__ import annotations

from math import isfinite
from typing import Annotated, Any, Literal

from pydantic import PlainValidator, WithJsonSchema

SMALLEST_MM, LARGEST_MM = 1e-6, 1.0  # what lies outside is a wrong unit: pitches are some hundredths of a mm


def _blur(value: Any) -> float | str:
    if value == "auto":
        return "auto"
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ValueError(f'{value!r} is neither a number of mm nor "auto"')
    if value != 0 and not SMALLEST_MM <= value <= LARGEST_MM:
        raise ValueError(f"{value:g} is neither 0 nor between {SMALLEST_MM:g} and {LARGEST_MM:g} mm")
    return float(value)


BlurMm = Annotated[float | Literal["auto"], PlainValidator(_blur), WithJsonSchema({"type": ["number", "string"]})]
