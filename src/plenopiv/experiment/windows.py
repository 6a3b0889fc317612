"""The key ``correlation.windows``: a list of sizes [x, y, z] in voxels."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

WindowSide = Annotated[int, Field(ge=1, le=1024)]
Window = Annotated[tuple[WindowSide, WindowSide, WindowSide], Field(strict=False)]  # strict models refuse lists


def _windows(value: Any) -> Any:
    if isinstance(value, list | tuple) and value and all(isinstance(side, int | float) for side in value):
        raise ValueError(f"must be a list of windows: {[list(value)]}")
    return value


Windows = Annotated[tuple[Window, ...], Field(strict=False, min_length=1), BeforeValidator(_windows)]
