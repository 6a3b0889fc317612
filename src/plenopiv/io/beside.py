"""What lies beside a velocity.nc and is of other results: statistics, tracks, a run that is not finished."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from plenopiv.errors import PlenoPIVWarning
from plenopiv.io import manifest as manifests
from plenopiv.io.manifest import Manifest, named_changes

VELOCITY, TRACKING = "velocity.nc", "tracking"
DERIVED = {"statistics.nc": "statistics", "phase-statistics.nc": "statistics --phase"}  # by which command
TABLES = "camera", "recording", "calibration", "medium"  # of the experiment file
WORK, INPUTS = ".plenopiv", "inputs.json"  # where an unfinished run is


def warn_of_earlier(directory: Path, before: Manifest | None, made: Manifest) -> None:
    """Warn of files in ``directory``, whose results are now ``made``, that are of those ``before`` or of other inputs:
    nobody sees it on them."""
    for words in [*_derived(directory, before, made), *_tracks(directory, made)]:
        warnings.warn(words, PlenoPIVWarning, stacklevel=2)


def _derived(directory: Path, before: Manifest | None, made: Manifest) -> Iterator[str]:
    if before is None or before.files.get(VELOCITY) == made.files.get(VELOCITY):
        return
    for name, command in DERIVED.items():
        if (directory / name).exists():
            yield f"{directory / name}: is of the earlier results; plenopiv {command} --overwrite makes it anew"


def _tracks(directory: Path, made: Manifest) -> Iterator[str]:
    """Of tracks and vectors in one folder that are of other recordings or settings."""
    is_of_tracks = directory.name == TRACKING and "tracking" in (made.inputs or {})
    other = directory.parent if is_of_tracks else directory / TRACKING
    beside = Manifest.read(other / manifests.NAME)
    if made.inputs is None or beside is None or beside.inputs is None:
        return
    if named := named_changes(_of_images(beside.inputs), _of_images(made.inputs)):
        what, command = ("velocity.nc", "run") if is_of_tracks else ("tracks", "track")
        yield f"{other}: its {what} are of other inputs ({named}); plenopiv {command} --overwrite makes them anew"


def _of_images(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """What of a run's inputs both commands see alike: how images were taken, not how they were evaluated."""
    settings = inputs.get("settings", {})
    tables = {name: settings[name] for name in TABLES if name in settings}
    return {**tables, "files": inputs.get("files", {})}


def unfinished(directory: Path) -> str:
    """How far a run in ``directory`` is whose results are not there yet, in words; "" where there is none."""
    stated = manifests.whole_file(directory / WORK / INPUTS)
    finished = len(list((directory / WORK / "pairs").glob("*.json")))
    if stated is None or not finished:
        return ""
    pairs = f"{finished} pair{'s' * (finished != 1)}"
    return f"a run that is not finished has {pairs} so far; plenopiv run with its experiment file goes on with it"


def warn_of_others(path: Path) -> None:
    """Warn where a ``velocity.nc`` is another one than was written (damaged, or changed since), or of results that an
    unfinished run is about to replace."""
    made = Manifest.read(path.parent / manifests.NAME) or Manifest()
    records = made.pairs.values() if len(made.pairs) == 1 else ()  # the field of one pair alone is its own
    hashed = {name: digest for record in records for name, digest in record["files"].items()} | made.files
    if path.name in hashed and not manifests.is_whole(path, hashed[path.name]):
        words = f"{path}: is not as it was written: changed since, or damaged; the command that made it makes it again"
        warnings.warn(words, PlenoPIVWarning, stacklevel=3)
    if words := unfinished(path.parent):
        warnings.warn(f"{path}: is of earlier results: {words}", PlenoPIVWarning, stacklevel=3)
