"""A finished run that kept its volumes, as what vectors can be measured from again."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.chain import Chain
from plenopiv.checks import Finding, PairCheck, common
from plenopiv.device.backend import Device
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io import manifest as manifests
from plenopiv.io.camera_tables import camera_of
from plenopiv.io.manifest import Manifest, changes, digest_of, is_whole
from plenopiv.io.volumes import read_volume
from plenopiv.recording import Recording
from plenopiv.run import space
from plenopiv.run.calibrated import chain_of, with_static_light
from plenopiv.run.frame import Progress
from plenopiv.run.inputs import COMPUTING, calibrating_files, calibration_of, of_image, stated_inputs
from plenopiv.run.judged import Judgement, PairJudge
from plenopiv.run.pair import PairRecord, volume_file
from plenopiv.run.solid import solid_of
from plenopiv.run.versions import versions
from plenopiv.volume import SparseVolume

AGAIN = "the same plenopiv run makes it again"


@dataclass(frozen=True)
class KeptVolumes:
    """A results folder with the volumes of its frames: its experiment, manifest and summary."""

    results: Path
    experiment: Experiment
    manifest: Manifest
    summary: Mapping[str, Any]

    @classmethod
    def of(cls, results: str | Path) -> KeptVolumes:
        """Those of a results folder; volumes are not looked at yet (``check``).

        Raises:
            PlenoPIVError: it is no folder of a finished run, its run kept no volumes, or its manifest, experiment or
                summary is damaged.
        """
        results = Path(results)
        if not results.is_dir():
            raise PlenoPIVError(f"{results}: no such folder; give the results folder of plenopiv run")
        manifest = Manifest.read(results / manifests.NAME)
        if manifest is None:
            raise PlenoPIVError(f"{results}: holds no finished run; plenopiv run makes one")
        if manifest.inputs is None or manifest.damaged:
            raise PlenoPIVError(f"{results / manifests.NAME}: is damaged; {AGAIN}")
        for name in ("experiment.toml", "summary.json"):
            if not is_whole(results / name, manifest.files.get(name, "")):
                raise PlenoPIVError(f"{results / name}: is gone, or not as its run left it; {AGAIN}")
        summary = json.loads((results / "summary.json").read_text(encoding="utf-8"))
        kept = cls(results, Experiment.load(results / "experiment.toml"), manifest, summary)
        if not kept.experiment.output.volumes:
            raise PlenoPIVError(
                f"{results}: its run kept no volumes; set output.volumes = true in its experiment file, and run it "
                "again with --overwrite"
            )
        return kept

    @property
    def name(self) -> str:
        """Of the folder."""
        return self.results.resolve().name

    @property
    def inputs(self) -> dict[str, Any]:
        """What the run depended on."""
        assert self.manifest.inputs is not None
        return self.manifest.inputs

    @cached_property
    def digests(self) -> dict[str, str]:
        """Hashes of the volumes' files by name."""
        records = self.manifest.pairs.values()
        return {name: digest for record in records for name, digest in record["files"].items() if name.endswith(".h5")}

    @property
    def other_versions(self) -> list[str]:
        """Versions that differ from those of the run."""
        known = versions()
        was = {name: version for name, version in self.inputs["versions"].items() if name in COMPUTING}
        return list(changes(was, {name: known[name] for name in COMPUTING}))

    def with_correlation(
        self,
        changed: Mapping[str, Any],
        out: Path | None = None,
        words: Sequence[str] = (),
        device: str | None = None,
    ) -> tuple[Experiment, Path]:
        """The experiment with other keys of [correlation], and its results folder: ``out``, or one beside the run's
        that is named by ``words``, the windows and what else is changed. ``device``: another ``compute.device``.

        Sub-windows are as the run's experiment file stated them, or derived from the last window anew.

        Raises:
            PlenoPIVError: keys or values cannot be used, or ``out`` is the run's own folder.
        """
        tables = self.experiment.on_device(device).model_dump(by_alias=True, exclude_none=True)
        correlation = tables["correlation"]
        if "inner_window" not in self.inputs["settings"]["correlation"]:
            correlation.pop("inner_window", None)
        correlation |= {key: value for key, value in changed.items() if value is not None}
        tables["output"]["volumes"] = False
        try:
            found = Experiment.from_dict(tables, self.experiment.path)
        except PlenoPIVError as error:  # of the keys that are given here, not of the run's file
            raise PlenoPIVError(str(error).removeprefix(f"{self.experiment.path}: ")) from None
        out = out or self._beside(found, changed, words)
        if out.resolve() == self.results.resolve():
            raise PlenoPIVError(f"{out}: holds the volumes; name another folder")
        try:
            tables["output"]["directory"] = os.path.relpath(out.resolve(), self.results.resolve())
        except ValueError:  # another drive
            tables["output"]["directory"] = str(out.resolve())
        return Experiment.from_dict(tables, self.experiment.path), out

    def _beside(self, experiment: Experiment, changed: Mapping[str, Any], first: Sequence[str]) -> Path:
        folder = self.results if self.results.name not in ("", "..") else self.results.resolve()
        words = [*first, *("x".join(map(str, window)) for window in experiment.correlation.windows)]
        for key, value in changed.items():
            if key != "windows" and value is not None:
                sides = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
                words += [key.replace("_", "-"), "x".join(map(str, sides))]
        return folder.with_name("-".join([folder.name, *words]))

    def check(self, recording: Recording) -> None:
        """Compare files with the manifest: those that calibrate, and all volumes that pairs are measured from.

        Raises:
            PlenoPIVError: one is gone, damaged or changed, or the recording has other frames.
        """
        pairs = self.manifest.pairs
        if sorted(pairs) != list(range(len(recording.pairs))):
            raise PlenoPIVError(
                f"{self.results}: holds {len(pairs)} pairs, the recording {len(recording.pairs)}; the same plenopiv "
                "run measures the others"
            )
        for number, record in pairs.items():
            was = [entry["name"] for entry in record["frames"]]
            now = [recording.frames[k].name for k in recording.pairs[number]]
            if was != now:
                raise PlenoPIVError(f"{self.results}: pair {number} was {' and '.join(was)}, is {' and '.join(now)}")
        stated, found = self.inputs["files"], calibrating_files(self.experiment, recording)
        for name in sorted(stated.keys() | found.keys()):
            if stated.get(name) != found.get(name):
                raise PlenoPIVError(
                    f"{name}: is another file than the one that the volumes of {self.results} were made with; put that "
                    "back, or run again with --overwrite"
                )
        frames = dict.fromkeys(k for number in self.measurable for k in recording.pairs[number])
        for name in (volume_file(recording, k) for k in frames):
            if not is_whole(self.results / name, self.digests.get(name, "")):
                raise self._not_whole(name)

    @cached_property
    def measurable(self) -> list[int]:
        """Numbers of the pairs whose frames were reconstructed and found good."""
        return [number for number, record in sorted(self.manifest.pairs.items()) if record["summaries"]]

    def volume(self, recording: Recording, number: int) -> SparseVolume:
        """The volume of frame ``number``.

        Raises:
            PlenoPIVError: its file is gone or damaged.
        """
        name = volume_file(recording, number)
        if not is_whole(self.results / name, self.digests[name]):
            raise self._not_whole(name)
        return read_volume(self.results / name, known=True)

    def _not_whole(self, name: str) -> PlenoPIVError:
        there = (self.results / name).exists()
        return PlenoPIVError(f"{self.results / name}: {'is damaged' if there else 'is gone'}; {AGAIN}")

    def record(self, number: int) -> PairRecord:
        """What the run found out about the frames of a pair; of one that it set aside for these, also why."""
        found = self.manifest.pairs[number]
        return PairRecord(
            number,
            found["frames"],
            None if found["summaries"] else found["set_aside"],
            [finding for finding in found["findings"] if finding["name"] != common.NAME],
            found["warnings"],
            summaries=found["summaries"],
        )

    def judgement(self, recording: Recording, camera: PlenopticCamera) -> Judgement:
        """What the checks said of the whole recording when it was run, and what judges fields."""
        of_pairs = [finding for record in self.manifest.pairs.values() for finding in record["findings"]]
        findings = [Finding(**finding) for finding in self.summary["findings"] if finding not in of_pairs]
        check = PairCheck(recording.sensor, None, camera, recording.unusable)
        judge = PairJudge(self.inputs["force"], check, tuple(finding.severity for finding in findings))
        return Judgement(judge, findings)

    def stated_inputs(self, experiment: Experiment, recording: Recording, device: Device) -> dict[str, Any]:
        """What results of ``experiment``, measured from these volumes, depend on, but for its calibration."""
        made = {"run": digest_of(self.inputs), "files": digest_of(self.digests)}
        return stated_inputs(experiment, recording, self.inputs["force"], device) | {"volumes": made}

    def chain(self, experiment: Experiment, recording: Recording, progress: Progress, device: Device) -> Chain:
        """The chain that measures between the volumes on a ``device``, of the camera that they were made with.

        Raises:
            PlenoPIVError: the manifest holds no camera; window, fluid, body or static light are not as they were; as
                ``solid_of`` and ``space_of``.
        """
        solid, stated, unusable = solid_of(experiment), self.inputs["calibration"], recording.unusable
        try:
            camera = camera_of(stated["camera"])
        except (AttributeError, KeyError, TypeError, ValueError, PlenoPIVError):
            line = f"{self.results / manifests.NAME}: holds no calibrated camera; run again with --overwrite"
            raise PlenoPIVError(line) from None
        if recording.background_of_frames:
            unusable = self._unusable(recording, camera, progress)
        chain = chain_of(experiment, camera, unusable, solid, space.space_of(experiment, recording))
        found = calibration_of(chain, recording)
        count = len(chain.unusable) if recording.background_of_frames else len(stated["images"])
        now, then = ([of["images"][:count], of.get("space")] for of in (found, stated))
        if now != then:
            raise PlenoPIVError(
                f"{self.results}: its files give another calibration now than when it was run (was it calibrated or "
                "self-calibrated since?); run again with --overwrite"
            )
        return chain.on_device(device)

    def _unusable(self, recording: Recording, camera: PlenopticCamera, progress: Progress) -> NDArray[np.bool_] | None:
        """Of a run that estimated static light from the frames, which may have shown hot pixels: only then are the
        frames needed again."""
        found = recording.dark_level()[1] | (False if recording.masked is None else recording.masked)
        if of_image(found) == self.inputs["calibration"]["images"][0]:
            return found
        return with_static_light(recording, camera, partial(progress, "static light of the frames"))[0].unusable
