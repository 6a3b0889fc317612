"""The results folder of a series: finished pairs are kept, whatever ends the run, and found again by the next one.

While a run goes on all that it writes lies in ``.plenopiv`` within the folder, laid out as in the folder itself: the
files of finished pairs, and a record of each. When the last one is done, the manifest is written there, and all is
moved into place, ``summary.json`` and the manifest last. Where a run was killed while it moved files, the next one goes
on with that. Results that were there before stay whole until then.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from plenopiv.errors import PlenoPIVError, told_of
from plenopiv.io import manifest as manifests
from plenopiv.io.aside import sweep_asides, written_aside
from plenopiv.io.beside import INPUTS, WORK, warn_of_earlier
from plenopiv.io.into_place import move_into_place
from plenopiv.io.lock import FolderLock
from plenopiv.io.made_folders import MadeFolders
from plenopiv.io.manifest import Manifest, Records, digest_of, hash_of, is_whole, named_changes, settled_otherwise
from plenopiv.io.output import COMPLETE, sweep_stages

GONE, LOCK = ".plenopiv-gone", "lock"
EXPERIMENT = "experiment.toml"  # among the results: of the run


class SeriesFolder:
    """``directory``, locked for the pairs ``first`` <= k < ``end``, for all of them without ``end``.

    ``begin`` compares what the results depend on, ``settle`` calibration and tiles; then ``finished`` holds the records
    of those of these pairs that are there and whole. ``store`` keeps a finished pair, ``publish`` moves all into place.

    Raises:
        PlenoPIVError: on entering: the folder is a file, cannot be written, or another run works on these pairs.
    """

    def __init__(self, directory: Path, overwrite: bool = False, first: int = 0, end: int | None = None):
        self.directory, self.work, self.overwrite = directory, directory / WORK, overwrite
        self.finished = Records()
        self.depends = ""
        self.words: list[str] = []  # on what was found damaged
        self._lock = FolderLock(self.work / LOCK, first, end)
        self._first, self._end, self._alone = first, end, end is None
        self._made = MadeFolders()
        self._mode = "new"  # "repair": whole pairs of the results are kept; "replace": none
        self._known: dict[str, Any] | None = None  # what the pairs that are there depend on
        self._results: Manifest | None = None
        self._unfinished: dict[str, Any] | None = None  # what the work folder says of itself

    def __enter__(self) -> SeriesFolder:
        if self.directory.exists() and not self.directory.is_dir():
            raise PlenoPIVError(f"{self.directory}: is a file; output.directory must name a folder")
        try:
            self._made.make(self.work)
        except OSError as error:
            self._made.remove()
            raise PlenoPIVError(f"{self.directory}: cannot be written ({error.strerror})") from None
        try:
            self._lock.__enter__()
        except BaseException:
            self._made.remove()
            raise
        try:
            if self._alone:
                self._sweep()
        except BaseException:
            self.__exit__(PlenoPIVError)
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *failure: object) -> None:
        try:
            if kind is not None and self.work.is_dir() and not self._stored() and self._lock.alone():
                self.discard()
        finally:
            self._lock.__exit__()
            self._made.remove()

    def begin(self, inputs: Mapping[str, Any]) -> None:
        """Compare what this run depends on, but for its calibration, with what is there.

        Raises:
            PlenoPIVError: results or an unfinished run of other inputs are there, and not ``overwrite``; an experiment
                file that no run wrote is there: the user's own, in whose folder the results are to be.
        """
        with self._lock.beginning() as none_has_begun:
            self._begin(inputs, none_has_begun)
            if self._unfinished is None:
                self._state(inputs)

    def _begin(self, inputs: Mapping[str, Any], none_has_begun: bool) -> None:
        unfinished = manifests.whole_file(self.work / INPUTS)
        if unfinished is not None and (named := named_changes(unfinished["inputs"], inputs)):
            if not self.overwrite:
                raise PlenoPIVError(
                    f"{self.directory}: holds an unfinished run of other inputs ({named}); --overwrite begins anew, "
                    "another output.directory keeps both"
                )
            if not none_has_begun:
                raise PlenoPIVError(f"{self.directory}: another run, of other inputs ({named}), works in this folder")
            self._clear()
            unfinished = None
        self._unfinished = unfinished
        self._results = Manifest.read(self.directory / manifests.NAME)
        if self._results is None and manifests.inputs_of_summary(self.directory) is not None:
            self._results = Manifest(damaged=1)
        complete = all((self.directory / name).exists() for name in COMPLETE)
        if unfinished is None and self._results is None and not complete and (self.directory / EXPERIMENT).exists():
            raise PlenoPIVError(
                f"{self.directory / EXPERIMENT}: no run wrote it, and results would replace it with their own; give "
                'output.directory a folder for the results alone, "results" say'
            )
        if unfinished is not None:
            self._mode, self._known = unfinished["mode"], unfinished["inputs"]
        elif self.overwrite:
            self._mode = "replace"
        elif self._results is not None:
            self._mode, self._known = "repair", self._results.inputs
            stated = {record.get("depends") for record in self._results.pairs.values()}
            stated |= {manifests.inputs_of_summary(self.directory)} - {None}
            if self._known is None and stated:
                self._known = {"digest": stated.pop()}
            if self._known is None:
                raise PlenoPIVError(
                    f"{self.directory / manifests.NAME}: is damaged, and nothing says what the results are made of; "
                    "use --overwrite, or another output.directory"
                )
            if "digest" not in self._known and (named := named_changes(self._known, inputs)):
                raise PlenoPIVError(
                    f"{self.directory}: holds a run of other inputs ({named}); use --overwrite, or another "
                    "output.directory"
                )
        elif complete:
            raise PlenoPIVError(f"{self.directory}: holds a complete run; use --overwrite, or another output.directory")
        if self._mode != "repair":
            self._results = None

    @property
    def calibration(self) -> Mapping[str, Any] | None:
        """What the pairs that are there, of the same inputs, were calibrated as; None where nothing says it."""
        known = [self._known, None if self._results is None else self._results.inputs]
        return next((inputs["calibration"] for inputs in known if inputs and "calibration" in inputs), None)

    def settle(self, inputs: Mapping[str, Any]) -> None:
        """Take ``inputs``, now with the calibration and the number of tiles, as what the pairs of this run depend on,
        and look for those that are there.

        Raises:
            PlenoPIVError: calibration or tiles are others, and not ``overwrite``; the folder cannot be written.
        """
        self.depends = digest_of(inputs)
        with self._lock.beginning() as none_has_begun:
            stated = manifests.whole_file(self.work / INPUTS)  # by now: others may have begun together with this run
            for known in (self._known, stated["inputs"] if stated else None):
                if known is not None and (other := settled_otherwise(known, inputs)):
                    if not (self.overwrite and none_has_begun):
                        raise PlenoPIVError(f"{self.directory}: holds a run of {other}")
                    self._clear()
                    self._mode, self._unfinished, self._results = "replace", None, None
            if self._unfinished is None or self._unfinished["inputs"].keys() != inputs.keys():
                self._state(inputs)
        self._look()

    @property
    def is_complete(self) -> bool:
        """Whether the results of ``inputs`` are there, every file as the manifest has it."""
        return self._results is not None and not self.words and not self._stored()

    def recorded(self) -> int:
        """How many pairs have a record, also those of other runs that work side by side."""
        stored = {path.name for path in (self.work / "pairs").glob("*.json")}
        results = self._results.pairs if self._results else ()
        return len(stored.union(Path(_record(number)).name for number in results))

    def path(self, name: str) -> Path:
        """Where to write a file that shall become ``directory / name``."""
        path = self.work / name
        with told_of(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def there(self, name: str) -> Path:
        """Where a file is that was finished: among the results, or in the making."""
        return self.work / name if (self.work / name).exists() else self.directory / name

    def write_text(self, name: str, text: str) -> None:
        """Write a text file (UTF-8) that shall become ``directory / name``."""
        self._write(name, text)

    def store(self, record: Mapping[str, Any], files: Iterable[str]) -> dict[str, Any]:
        """Keep the record of a pair (with the key "pair") whose ``files`` are written; returns it as it is kept.

        Raises:
            PlenoPIVError: the folder cannot be written, or is not this run's any more.
        """
        self._check_mine()
        hashes = {name: hash_of(self.work / name) for name in files}
        line = manifests.line({**record, "depends": self.depends, "files": hashes})
        self._write(_record(record["pair"]), line)
        kept = manifests.whole(line.removesuffix("\n"))
        assert kept is not None
        self.finished[record["pair"]] = kept  # as the next run will read it: the order of keys is that of the report
        return kept

    def publish(self, files: Iterable[str], inputs: Mapping[str, Any]) -> None:
        """Write the manifest and move all into place; ``files``: names of those that belong to no pair.

        Raises:
            PlenoPIVError: the folder cannot be written; the next run goes on with it. Or it is not this run's any more.
        """
        self._check_mine()
        listed = {name: hash_of(self.there(name)) for name in files}
        made = Manifest(dict(inputs), self.finished, listed)
        self._write(manifests.NAME, made.text())
        self._move(made)

    @property
    def is_mine(self) -> bool:
        """Whether the folder is still the one that this run locked: nobody removed, moved or replaced it."""
        return self._lock.is_there()

    def check_whole(self) -> None:
        """Raise PlenoPIVError where the folder is not this run's any more, or a finished pair's file is another one."""
        self._check_mine()
        listed = {name: digest for record in self.finished.values() for name, digest in record["files"].items()}
        for name, digest in listed.items():
            if name.endswith(".h5") or is_whole(path := self.there(name), digest):
                continue  # of kept volumes, which are large, nothing is put together
            raise PlenoPIVError(f"{path}: {_wrong(path)} since its pair was measured; begin the command again")

    def _check_mine(self) -> None:
        if not self.is_mine:
            raise PlenoPIVError(f"{self.directory}: was removed or replaced while this run went on; begin it again")

    def discard(self) -> None:
        """Forget what was made of this run, unless others work on it."""
        if not self._lock.alone():
            return
        gone = self.directory / GONE
        shutil.rmtree(gone, ignore_errors=True)
        with suppress(OSError):  # in one step: half of the records would pass for an unfinished run
            os.rename(self.work, gone)
        shutil.rmtree(gone, ignore_errors=True)
        shutil.rmtree(self.work, ignore_errors=True)  # where an open file keeps its folder from being renamed

    def _look(self) -> None:
        """Fill ``finished``."""
        stored = Records()
        if self._results:
            if many := self._results.damaged:
                self.words.append(f"{self.directory / manifests.NAME}: {many} line{'s'[: many > 1]} damaged or gone")
            paths = [
                self.directory / name for name, hashed in self._results.files.items() if not self._has(name, hashed)
            ]
            self.words += [f"{path}: {_wrong(path)}; it is made again" for path in paths]
        for path in sorted((self.work / "pairs").glob("*.json")):
            record = manifests.whole_file(path)
            if record is None:
                self.words.append(f"{path}: is damaged; its pair is measured again")
            else:
                stored[record["pair"]] = record
        results = self._results.pairs if self._results else Records()
        for number in sorted(stored.keys() | results.keys()):
            published = number not in stored
            record = (results if published else stored)[number]
            if record.get("depends") != self.depends or not self._is_mine(number):
                continue
            broken = [name for name, hashed in record["files"].items() if not self._has(name, hashed, published)]
            if broken:
                path = self.directory / broken[0] if published else self.there(broken[0])
                self.words.append(f"{self.directory / broken[0]}: {_wrong(path)}; pair {number} is measured again")
            else:
                self.finished[number] = record
        if self._alone:
            self._remove_strays()

    def _is_mine(self, number: int) -> bool:
        return self._end is None or self._first <= number < self._end

    def _has(self, name: str, hashed: str, published: bool = True) -> bool:
        """Whether a file is whole, among the results if it was ``published``: one in the making may be there too."""
        return is_whole(self.directory / name if published else self.there(name), hashed)

    def _remove_strays(self) -> None:
        """Remove what a killed run wrote, and no record lists."""
        known = {LOCK, INPUTS, *(_record(number) for number in self.finished)}
        known |= {name for record in self.finished.values() for name in record["files"]}
        for path in self.work.rglob("*"):
            if path.is_file() and path.relative_to(self.work).as_posix() not in known:
                with told_of(path):
                    path.unlink(missing_ok=True)

    def _stored(self) -> bool:
        """Whether a finished pair lies in the work folder."""
        return any((self.work / "pairs").glob("*.json"))

    def _sweep(self) -> None:
        """End what a killed run left: files half written, and moves."""
        for path in self.work.rglob(".*.part"):
            with suppress(OSError):
                path.unlink()
        for folder in (self.directory, self.directory / "pairs"):  # where other commands write, too
            sweep_asides(folder)
        sweep_stages(self.directory)
        shutil.rmtree(self.directory / GONE, ignore_errors=True)
        if (self.work / manifests.NAME).exists():
            made = Manifest.read(self.work / manifests.NAME)
            if made is not None and made.inputs is not None and not made.damaged:
                self._move(made)
                self._made.keep()
                self.work.mkdir(exist_ok=True)
                self._lock.__exit__()
                self._lock.__enter__()
            else:
                (self.work / manifests.NAME).unlink()

    def _move(self, made: Manifest) -> None:
        before = move_into_place(made, self.work, self.directory)
        warn_of_earlier(self.directory, before, made)
        self.discard()
        self._made.keep()

    def _clear(self) -> None:
        """Forget an unfinished run, but not the lock."""
        for path in sorted(self.work.iterdir(), key=lambda path: path.name == INPUTS):  # that one last
            if path.name != LOCK:
                with told_of(path):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()

    def _state(self, inputs: Mapping[str, Any]) -> None:
        """Write down what the pairs in the work folder depend on."""
        self._write(INPUTS, manifests.line({"inputs": inputs, "mode": self._mode}))

    def _write(self, name: str, text: str) -> None:
        with written_aside(self.path(name)) as aside:
            aside.write_text(text, encoding="utf-8", newline="\n")


def _wrong(path: Path) -> str:
    return "is damaged" if path.exists() else "is gone"


def _record(pair: int) -> str:
    return f"pairs/pair-{pair:04d}.json"
