"""What a check found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["good", "warning", "unusable"]


@dataclass(frozen=True)
class Finding:
    """One result of a check.

    ``name`` stays the same from version to version, for programs; ``words`` say what was found, ``advice`` what to do
    (empty where all is well). ``number`` in ``unit`` is the measure behind it, None where there is none.
    """

    name: str
    severity: Severity
    words: str
    number: float | None = None
    unit: str = ""
    advice: str = ""
