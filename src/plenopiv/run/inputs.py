"""What a result depends on: program, settings, images that calibrate, and the frames of each pair.

Two runs of the same inputs give the same bits, so pairs that one has finished are kept by the other.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.chain import Chain
from plenopiv.device.backend import CPU, Device
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.camera_tables import tables_of
from plenopiv.io.manifest import digest_of, sha256
from plenopiv.io.output import plain
from plenopiv.recording import ImageSource, Recording
from plenopiv.recording.formats import split
from plenopiv.run.versions import versions

COMPUTING = ("plenopiv", "numpy", "scipy", "numba", "llvmlite")  # libraries whose version may change bits


def stated_inputs(experiment: Experiment, recording: Recording, force: bool, device: Device = CPU) -> dict[str, Any]:
    """Inputs that are known before anything is computed: versions, device, settings, and hashes of the images that
    calibrate, of target, mask and body. ``device``: what ``experiment.compute`` asks for, as it was found.
    """
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    for name in ("simulation", "compute", "tracking"):  # the last is another command's
        tables.pop(name, None)
    tables["output"].pop("directory", None)
    for name in ("frames", "pairs"):  # lists grow with a recording; pairs' records name their frames
        tables["recording"].pop(name, None)
    return {
        "versions": computing_versions(device),
        "device": device.stated,
        "force": force,
        "settings": plain(tables),
        "files": calibrating_files(experiment, recording),
    }


def calibrating_files(experiment: Experiment, recording: Recording) -> dict[str, str | None]:
    """Hashes of the images that calibrate, of target, mask and body, by name; None of a file that cannot be read."""
    files = {
        "white": recording.white_path,
        "dark": recording.dark_path,
        **{f"background {k + 1}": path for k, path in enumerate(recording.background_paths)},
        "mask": recording.mask if isinstance(recording.mask, Path) else None,
        "body": experiment.folder / experiment.volume.body if experiment.volume.body else None,
    }
    return {name: _of_file(path) for name, path in with_target(experiment, files).items()}


def with_target(experiment: Experiment, files: Mapping[str, Path | None]) -> dict[str, Path]:
    """Files, given by what they are, and the images of the target, by name: the file's, and with what it is where
    another file has that name too, as where a camera numbers the images of each folder from 1."""
    named = [(path.name, what, path) for what, path in files.items() if path is not None]
    if experiment.calibration is not None:
        images = [plane.image for plane in experiment.calibration.planes]
        of_target = zip(names_of(images), images, strict=True)
        named += [(name, "target", experiment.folder / image) for name, image in of_target]
    having = Counter(name for name, _ in {(name, path) for name, _, path in named})
    return {name if having[name] == 1 else f"{name} ({what})": path for name, what, path in named}


def names_of(images: Sequence[str]) -> list[str]:
    """Names of the images of a target, wherever they lie: of the file, and with a number where it is another's too."""
    names = [Path(image).name for image in images]
    return [name if names.count(name) == 1 else f"{name} ({k + 1})" for k, name in enumerate(names)]


def computing_versions(device: Device = CPU) -> dict[str, str]:
    """Versions that bits may depend on."""
    known = versions()
    return {name: known[name] for name in COMPUTING} | dict(device.versions)


def with_calibration(
    inputs: Mapping[str, Any], chain: Chain, recording: Recording, found: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The same, and what calibration made of the images: lattice, shot noise, pixels left out, static light,
    and the map to the laboratory; of what was ``found`` the drift, which a recording that grows keeps."""
    drift = {key: value for key, value in (found or {}).items() if key == "drift"}
    return {**inputs, "calibration": calibration_of(chain, recording) | drift}


def calibration_of(chain: Chain, recording: Recording) -> dict[str, Any]:
    """What calibration made of the images, for comparison; "space" only where x, y, z are the laboratory's."""
    static = recording.static_light
    arrays = [*chain.unusable, *([] if static is None else [static.dark, *(static.pulses or ())])]
    return {
        "camera": tables_of(chain.camera),
        "counts_per_electron": exactly(chain.counts_per_electron),
        "images": [None if array is None else of_image(array) for array in arrays],
        **({} if chain.space is None else {"space": digest_of(exactly(chain.space))}),
    }


def exactly(value: Any) -> str:
    """All that a dataclass holds, and dataclasses in it, to the last bit, where ``repr`` is short."""
    if is_dataclass(value) and not isinstance(value, type):
        held = [f"{each.name}={exactly(getattr(value, each.name))}" for each in fields(value) if each.repr]
        return f"{type(value).__qualname__}({', '.join(held)})"
    if type(value) is dict:
        return "{" + ", ".join(f"{exactly(key)}: {exactly(each)}" for key, each in value.items()) + "}"
    if type(value) is tuple:
        return f"({', '.join(map(exactly, value))}{',' * (len(value) == 1)})"
    return repr(value)


def of_image(image: NDArray) -> str:
    """Hash of an image."""
    return hashlib.sha256(np.ascontiguousarray(image).data).hexdigest()


def frame_entry(source: ImageSource) -> dict[str, Any]:
    """The manifest's entry of a frame that was not read: name, size and times of its file (written; changed or moved,
    which no copy can set)."""
    try:
        found = source.path.stat()
        size, written, changed = found.st_size, found.st_mtime_ns, found.st_ctime_ns
    except OSError:
        size, written, changed = None, None, None
    return {"name": source.name, "bytes": size, "mtime_ns": written, "ctime_ns": changed, "sha256": None}


def read_entry(entry: Mapping[str, Any], image: NDArray) -> dict[str, Any]:
    """The ``entry`` of a frame whose ``image`` was read: its hash tells a change, and no time that a copy does not
    keep."""
    return {name: told for name, told in entry.items() if name != "ctime_ns"} | {"sha256": of_image(image)}


def changed_frame(recording: Recording, record: Mapping[str, Any]) -> str | None:
    """What changed of the frames of a pair since they were measured; None where nothing did.

    An image is read where the size or the time of its file is another one, and where the file of the pair's other frame
    had the same ones: they may be exchanged. A lost frame may have been mended by a copy of the same size and time:
    there the file's change is enough. A file that is gone tells nothing.
    """
    pair = recording.pairs[record["pair"]]
    was, now = [entry["name"] for entry in record["frames"]], [recording.frames[k].name for k in pair]
    if was != now:
        return f"pair {record['pair']} was {was[0]} and {was[1]}, is {now[0]} and {now[1]}"
    files = {recording.frames[k].path for k in pair}  # one alone where they are pages or halves
    alike = len({(entry.get("bytes"), entry.get("mtime_ns")) for entry in record["frames"]}) < len(files)
    for k, entry in zip(pair, record["frames"], strict=True):
        found = frame_entry(recording.frames[k])
        told = ("bytes", "mtime_ns") if entry["sha256"] else ("bytes", "mtime_ns", "ctime_ns")
        same_file = all(entry.get(name) == found[name] for name in told) and not (alike and entry["sha256"])
        if found["bytes"] is None or same_file:
            continue
        try:
            same = of_image(recording.light(k)[0]) == entry["sha256"]
        except PlenoPIVError:
            same = False
        if not same:
            was_read = "the one that was measured" if entry["sha256"] else "the one that could not be read"
            return f"{recording.frames[k].name} is another image than {was_read}"
    return None


def _of_file(name: Path) -> str | None:
    """Hash of a file, or of an HDF5 file's data set alone, as frames may be added beside it; None where it cannot be
    read, which is told when it is used."""
    path, dataset = split(name)
    try:
        return of_image(ImageSource(path, dataset=dataset).values()) if dataset else sha256(path)
    except (OSError, PlenoPIVError):
        return None
