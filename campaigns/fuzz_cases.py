"""The cases: of each kind a number of them, each a folder of files, one of them spoilt, and a command line.

A case follows from the seed, its kind and its number alone.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import fuzz_mutations as spoil
from fuzz_corpus import FLOW_TABLE
from fuzz_formats import change_hdf5, change_tiff

SEED = 25
COUNT = 3000  # in all
KINDS = ("image", "experiment", "optics", "flow", "results")
RECORDING = ("white.tif", "a.tif", "b.tif")
WRITTEN = {  # what a command may leave where it ends well
    "init": ("*/experiment.toml",),
    "calibrate": ("*/lattice.toml",),
    "check": ("*/look", "*/look/check.png"),
    "views": ("*/look", "*/look/views-*.png"),
    "simulate": ("made", "made/*"),
    "export": ("out.vtkhdf", "out.txt"),
    "info": (),
}


@dataclass(frozen=True)
class Case:
    """``number``: from 0 within its kind."""

    kind: str
    number: int
    seed: int = SEED

    @property
    def name(self) -> str:
        """As results and the command line have it."""
        return f"{self.kind}:{self.number}"

    def random(self, draw: int = 0) -> Random:
        """Its own generator; ``draw``: another one, where HDF5 crashed while it spoilt the file."""
        text = f"{self.seed} {self.name}{f' {draw}' if draw else ''}"
        return Random(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big"))


@dataclass
class Prepared:
    """What a case is made of: files by their name in its folder, the one that is spoilt, and the command line."""

    files: dict[str, bytes]
    spoilt: str
    command: list[str] = field(default_factory=list)


def cases(count: int = COUNT, seed: int = SEED) -> list[Case]:
    """``count`` cases, as many of each kind, in turn."""
    return [Case(KINDS[k % len(KINDS)], k // len(KINDS), seed) for k in range(count)]


def prepared(case: Case, corpus: Path, draw: int = 0) -> Prepared:
    """The files of a case from those of ``fuzz_corpus``."""
    rng = case.random(draw)
    return {"image": _image, "experiment": _experiment, "optics": _optics, "flow": _flow, "results": _results}[
        case.kind
    ](rng, corpus)


def _changed(rng: Random, data: bytes, changes: list[spoil.Change]) -> bytes:
    """One change, or some one after the other."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(changes)(rng, data)
    return data


def _recording(corpus: Path, folder: str) -> dict[str, bytes]:
    files = {f"{folder}/{name}": (corpus / "rec" / name).read_bytes() for name in RECORDING}
    return files | {f"{folder}/experiment.toml": (corpus / "draft" / "experiment.toml").read_bytes()}


def _image(rng: Random, corpus: Path) -> Prepared:
    """An image of any format, by itself or within a recording."""
    if rng.random() < 0.45:
        path = rng.choice(sorted((corpus / "images").glob("*.tif")))
        made = Prepared({path.name: _spoilt_tiff(rng, path.read_bytes())}, path.name)
        made.command = ["info", path.name]
        return made
    files = _recording(corpus, "run 7")
    if rng.random() < 0.6:
        name = f"run 7/{rng.choice(RECORDING)}"
        same_size = [p for p in sorted((corpus / "images").glob("*.tif")) if p.stem not in ("pages", "eight")]
        base = files[name] if rng.random() < 0.5 else rng.choice(same_size).read_bytes()
        files[name] = _spoilt_tiff(rng, base)
        command = rng.choice(("init", "calibrate", "calibrate", "check"))
    else:
        path = rng.choice([p for p in sorted((corpus / "images").iterdir()) if p.suffix != ".tif"])
        name, data = f"run 7/{path.name}", path.read_bytes()
        changes = [*spoil.BYTES, change_hdf5, spoil.move_addresses] if path.suffix == ".h5" else [*spoil.BYTES]
        files[name] = _changed(rng, data, [spoil.replace_number, *changes] if path.suffix == ".npy" else changes)
        named = {
            "image.png": '["image.png", "b.tif"]',
            "image.npy": '["image.npy", "b.tif"]',
            "stack.npy": '"stack.npy"',
        }
        frames = named.get(path.name, '"frames.h5::run/frames"')
        text = files["run 7/experiment.toml"].decode()
        files["run 7/experiment.toml"] = text.replace('["a.tif", "b.tif"]', frames).encode()
        command = rng.choice(("calibrate", "check", "views"))
    made = Prepared(files, name, [command, "run 7/experiment.toml"])
    if command == "init":
        made.files["optics.json"] = (corpus / "optics.json").read_bytes()
        made.command = ["init", "run 7", "optics.json", "--overwrite"]
    return made


def _spoilt_tiff(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.6:
        data = change_tiff(rng, data)
    return data if rng.random() < 0.6 else _changed(rng, data, spoil.BYTES)


def _experiment(rng: Random, corpus: Path) -> Prepared:
    """An experiment file, changed as a table or as text."""
    files = _recording(corpus, "run 7")
    source = rng.choice(("draft", "rec"))
    text = (corpus / source / "experiment.toml").read_bytes()
    if rng.random() < 0.1:
        text += FLOW_TABLE.encode()
    files["run 7/experiment.toml"] = _spoilt_text(rng, text, as_json=False)
    command = rng.choice(("info", "info", "info", "info", "calibrate", "check"))
    return Prepared(files, "run 7/experiment.toml", [command, "run 7/experiment.toml"])


def _spoilt_text(rng: Random, text: bytes, as_json: bool) -> bytes:
    """Settings with other keys or values, or other text."""
    what = rng.random()
    if what < 0.55:
        tables = json.loads(text) if as_json else tomllib.loads(text.decode())
        changed = spoil.change_tables(rng, tables)
        text = spoil.as_json(changed) if as_json else spoil.as_toml(changed)
    if what > 0.5:
        text = _changed(rng, text, [*spoil.TEXT, *spoil.TEXT, *spoil.BYTES])
    return text


def _optics(rng: Random, corpus: Path) -> Prepared:
    """An optics sheet, for a draft of an experiment file."""
    name = rng.choice(("optics.json", "optics.json", "optics.toml"))
    files = _recording(corpus, "run 7")
    files[name] = _spoilt_text(rng, (corpus / name).read_bytes(), as_json=name.endswith("json"))
    return Prepared(files, name, ["init", "run 7", name, "--overwrite"])


def _flow(rng: Random, corpus: Path) -> Prepared:
    """A file of velocities, or what the experiment file says about it, for a simulated recording."""
    path = rng.choice(sorted((corpus / "flows").iterdir()))
    data = path.read_bytes()
    text = (corpus / "rec" / "experiment.toml").read_bytes() + FLOW_TABLE.replace("FLOW", path.name).encode()
    spoilt = path.name
    if rng.random() < 0.2:
        tables = tomllib.loads(text.decode())
        if rng.random() < 0.7:
            tables["simulation"]["parameters"] = spoil.change_tables(rng, tables["simulation"]["parameters"])
        else:
            tables["simulation"] = spoil.change_tables(rng, tables["simulation"])
        text, spoilt = spoil.as_toml(tables), "experiment.toml"
    elif path.suffix == ".nc":
        data = _spoilt_hdf5(rng, data)
    else:
        data = _changed(rng, data, [*spoil.TEXT, *spoil.BYTES])
    files = {path.name: data, "experiment.toml": text}
    return Prepared(files, spoilt, ["simulate", "experiment.toml", "made"])


def _spoilt_hdf5(rng: Random, data: bytes) -> bytes:
    what = rng.random()
    if what < 0.55:
        data = change_hdf5(rng, data)
    if what > 0.45:
        data = _changed(rng, data, [*spoil.BYTES, spoil.move_addresses, spoil.move_addresses, spoil.move_addresses])
    return data


def _results(rng: Random, corpus: Path) -> Prepared:
    """A file of vectors, to be described or written for other programs."""
    name = rng.choice(("one.nc", "two.nc"))
    data = _spoilt_hdf5(rng, (corpus / "results" / name).read_bytes())
    if rng.random() < 0.03:
        data = rng.choice((b"", b"no results\n", b"\x89HDF\r\n\x1a\n", b"CDF\x01" + bytes(200)))
    command = rng.choice((["info", name], ["export", name, "out.vtkhdf"], ["export", name, "out.txt", "--z", "0"]))
    return Prepared({name: data}, name, command)
