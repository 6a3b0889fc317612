"""The particles of one frame with their tracks, as a series of frames keeps them: what the next frame begins with.

A NumPy archive: netCDF of so many small arrays takes a tenth of the time of a frame.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.io.aside import written_aside


def write_particles(path: str | Path, values: Mapping[str, ArrayLike]) -> None:
    """Write arrays and numbers by their names; a file of that name is replaced in one step.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    with written_aside(path) as aside, aside.open("wb") as file:
        np.savez(file, **{name: np.asarray(each) for name, each in values.items()})  # type: ignore[arg-type]


def read_particles(path: str | Path) -> dict[str, NDArray]:
    """What ``write_particles`` wrote.

    Raises:
        PlenoPIVError: it is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise PlenoPIVError(f"{path}: is damaged ({' '.join(str(error).split())[:100]}); remove it") from None
