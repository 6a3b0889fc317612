"""The files of a series that is finished, moved from the folder in which they were made to the results."""

from __future__ import annotations

import os
from pathlib import Path

from plenopiv.errors import PlenoPIVError
from plenopiv.io import manifest as manifests
from plenopiv.io.aside import moved, sync_names
from plenopiv.io.manifest import Manifest
from plenopiv.io.output import COMPLETE

LAST = (*COMPLETE, manifests.NAME)  # moved last, in this order


def move_into_place(made: Manifest, work: Path, directory: Path) -> Manifest | None:
    """Move what ``work`` holds of the files of ``made`` into ``directory``; what the results there had besides is
    removed. Where it was ended, a second time goes on from there. Returns the manifest that was there before.

    Raises:
        PlenoPIVError: a file cannot be written.
    """
    before = Manifest.read(directory / manifests.NAME)
    listed = files_of(made)
    names = [name for name in sorted(listed - set(LAST)) if (work / name).exists()]
    names += [name for name in LAST if (work / name).exists()]
    try:
        for name in names:
            with (work / name).open("rb") as file:
                os.fsync(file.fileno())
            (directory / name).parent.mkdir(exist_ok=True, parents=True)
        (directory / COMPLETE[-1]).unlink(missing_ok=True)  # no complete run until all is moved
        for name in names:
            moved(work / name, directory / name)
        if before is not None:
            for name in files_of(before) - listed - {manifests.NAME}:
                (directory / name).unlink(missing_ok=True)
        for folder in {(directory / name).parent for name in names} | {directory}:
            sync_names(folder)
    except OSError as error:
        where = error.filename2 or error.filename or directory
        raise PlenoPIVError(f"{where}: cannot be written ({error.strerror})") from None
    return before


def files_of(made: Manifest) -> set[str]:
    """Names of all files that a manifest lists."""
    return set(made.files) | {name for record in made.pairs.values() for name in record["files"]}
