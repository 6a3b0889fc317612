"""What a command may not write over."""

from __future__ import annotations

from pathlib import Path

from plenopiv.errors import PlenoPIVError


def refuse_to_replace(target: Path, sources: tuple[Path, ...], overwrite: bool, other: str = "another name") -> None:
    """Raise PlenoPIVError where ``target`` is one of the ``sources`` that are read, which not even ``overwrite``
    replaces, or is there already; ``other``: what to choose instead."""
    if not target.exists():
        return
    if any(source.exists() and target.samefile(source) for source in sources):
        raise PlenoPIVError(f"{target}: is what would be read; write to {other}")
    if not overwrite:
        raise PlenoPIVError(f"{target}: is there already; use --overwrite, or {other}")
