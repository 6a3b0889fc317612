"""The experiment file as an object: what was recorded, with which camera, and what to make of it."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Sequence
from math import prod, radians
from pathlib import Path
from typing import Any

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from plenopiv.cameras.consistency import contradictions, mismatch
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.experiment import changes, in_view, messages, text
from plenopiv.experiment.compute import ComputeTable
from plenopiv.experiment.medium import MediumTable, medium_contradictions
from plenopiv.experiment.simulation_tables import SimulationTable
from plenopiv.experiment.tables import (
    CalibrationTable,
    CameraTable,
    CorrelationTable,
    OutputTable,
    ReconstructionTable,
    RecordingTable,
    Table,
    VolumeTable,
)
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.lattice import Lattice
from plenopiv.recording import Recording
from plenopiv.recording.pairs import Pairs, sequence
from plenopiv.recording.pairs import pairs as pairs_of
from plenopiv.sensor import Sensor
from plenopiv.volume import VoxelGrid

LARGEST_SIDE = 2**16 - 1  # voxels: sparse volumes keep 16 bits for a voxel's place in its row
LARGEST_VOLUME = 1e10  # voxels: more is a wrong unit, or needs several runs


class Experiment(Table):
    """An experiment file. The tables [camera] and [recording] are ``camera_table`` and ``recording_table``."""

    camera_table: CameraTable = Field(alias="camera")
    calibration: CalibrationTable | None = None
    medium: MediumTable | None = None
    recording_table: RecordingTable = Field(alias="recording")
    volume: VolumeTable
    reconstruction: ReconstructionTable = ReconstructionTable()
    correlation: CorrelationTable
    compute: ComputeTable = ComputeTable()
    tracking: TrackingTable | None = None
    output: OutputTable = OutputTable()
    simulation: SimulationTable | None = None
    _path: Path = PrivateAttr(default=Path("experiment.toml"))

    @classmethod
    def load(cls, path: str | Path) -> Experiment:
        """Read an experiment file.

        Raises:
            PlenoPIVError: one line that names the file and the first problem in full, others by key: a missing file,
                broken TOML (with its line), unknown keys (with the nearest right one), missing keys, wrong types, NaN,
                numbers out of range, a volume that the camera cannot see.
        """
        path = Path(path)
        try:
            with path.open("rb") as file:
                content = file.read(text.LARGEST + 1)
        except FileNotFoundError:
            hint = "plenopiv init drafts an experiment file from a folder of images"
            raise PlenoPIVError(f"{path}: no such file; {hint}") from None
        except IsADirectoryError:
            raise PlenoPIVError(f"{path}: is a folder; name the experiment file in it") from None
        except OSError as error:
            raise PlenoPIVError(f"{path}: cannot be read ({error.strerror})") from None
        except ValueError:  # a NUL in the name
            raise PlenoPIVError(f"{path}: is no file name") from None
        return cls.from_dict(text.tables(content, path), path)

    @classmethod
    def from_dict(cls, tables: dict[str, Any], path: str | Path = "experiment.toml") -> Experiment:
        """An experiment from nested tables; ``path`` names it in errors, and relative paths start from its folder.

        Raises:
            PlenoPIVError: as ``load`` does.
        """
        try:
            experiment = cls.model_validate(tables)
        except ValidationError as error:
            raise PlenoPIVError(messages.one_line(str(path), messages.problems(error, cls))) from None
        experiment._path = Path(path)
        return experiment

    @model_validator(mode="after")
    def _possible(self) -> Experiment:
        """Check that the tables do not contradict one another; each problem a line."""
        lines = self._camera_contradictions() or self._volume_contradictions()
        if lines:
            raise ValueError("\n".join(lines))
        return self

    def _camera_contradictions(self) -> list[str]:
        array = self.camera_table.microlens_array
        lines = [f"camera.{line}" for line in contradictions(self.camera())]
        if self.recording_table.white is None and (array.rotation_deg is None or array.offset_mm is None):
            lines.append(
                "recording.white: missing; name the white image, or say where the microlenses are with "
                "camera.microlens_array.rotation_deg and offset_mm"
            )
        if self.camera_table.main_lens.blur_mm == "auto" and self.blur_measured is None:
            lines.append(
                'camera.main_lens.blur_mm: "auto" needs a camera in air, without [calibration] and [medium]; '
                "aberration widens particles too: give a number"
            )
        if self.output.volumes and self.reconstruction.motion_tracking:
            lines.append(
                "output.volumes: with reconstruction.motion_tracking each pair has volumes of its own, which are not "
                "kept; leave out one of the two"
            )
        return lines

    def _volume_contradictions(self) -> list[str]:
        limits = (self.volume.x_mm, self.volume.y_mm, self.volume.z_mm)
        camera = self.camera()
        of_camera = self.calibration is None  # else limits are a target's
        if self.medium is not None:
            lens_z = camera.main_lens.object_distance_mm
            if lines := medium_contradictions(self.medium, lens_z, limits if of_camera else None):
                return lines
        as_in_air = of_camera and self.medium is None
        if as_in_air and (lines := in_view.behind_lens(self.volume, camera)):
            return lines
        sides = [max((hi - lo) / voxel, 1.0) for (lo, hi), voxel in zip(limits, self.volume.voxel_mm, strict=True)]
        if prod(sides) > LARGEST_VOLUME or max(sides) > LARGEST_SIDE:
            counts = " x ".join(f"{side:.5g}" for side in sides)
            return [f"volume.voxel_mm: {counts} voxels are too many; are all lengths in mm?"]
        if wide := [axis for axis, side in zip("xyz", sides, strict=True) if side <= 1.0]:  # no window fits anyway
            voxel = ", ".join(f"{length:g}" for length in self.volume.voxel_mm)
            return [
                f"volume.voxel_mm: a voxel of [{voxel}] is as large as the volume along {', '.join(wide)}; is it in mm?"
            ]
        if self.tracking is not None and (line := self.tracking.contradiction(limits)):
            return [line]
        if as_in_air and (lines := in_view.unseen(self.volume, camera)):
            return lines
        nz, ny, nx = self.grid().shape
        try:
            self.correlation.settings()
        except PlenoPIVError as error:
            return [str(error)]
        lines = []
        for number, window in enumerate(self.correlation.windows):
            for axis, side, total in zip("xyz", window, (nx, ny, nz), strict=True):
                if side > total:
                    lines.append(
                        f"correlation.windows[{number}]: {side} voxels along {axis} do not fit into a volume of {total}"
                    )
        return lines

    @property
    def path(self) -> Path:
        """The file this came from."""
        return self._path

    @property
    def folder(self) -> Path:
        """What the file's relative paths are relative to."""
        return self._path.parent

    @property
    def output_directory(self) -> Path:
        """The results folder."""
        return self.folder / self.output.directory

    def camera(self) -> PlenopticCamera:
        """The camera as designed, its lattice as the file says: upright and on the axis where it says nothing. A
        blur of "auto" is 0 until it is measured."""
        lens, array, sensor = self.camera_table.main_lens, self.camera_table.microlens_array, self.camera_table.sensor
        return PlenopticCamera(
            MainLens(lens.focal_length_mm, lens.diameter_mm, lens.magnification),
            Lattice(array.lattice, array.pitch_mm, radians(array.rotation_deg or 0.0), array.offset_mm or (0.0, 0.0)),
            array.focal_length_mm,
            Sensor(**sensor.model_dump()),
            blur_mm=0.0 if lens.blur_mm == "auto" else lens.blur_mm,
        )

    @property
    def blur_measured(self) -> bool | None:
        """Whether the main lens' blur is that which the particles show; None where they do not tell it from aberration,
        by a target or behind a window."""
        if self.calibration is not None or self.medium is not None:
            return None
        return self.camera_table.main_lens.blur_mm == "auto"

    @property
    def drift_measured(self) -> bool:
        """Whether microlenses that have moved since the white image are followed."""
        return self.recording_table.drift == "auto" and self.recording_table.white is not None

    def grid(self) -> VoxelGrid:
        """The voxels of [volume]."""
        volume = self.volume
        return VoxelGrid.covering(volume.x_mm, volume.y_mm, volume.z_mm, volume.voxel_mm)

    def recording(self) -> Recording:
        """The images, checked to exist and to fit the sensor.

        Raises:
            PlenoPIVError: see ``Recording``; or ``dump_toml`` could not name them in the results folder.
        """
        self._check_names()
        table, folder = self.recording_table, self.folder
        white = None if table.white is None else folder / table.white
        dark = None if table.dark is None else folder / table.dark
        background = tuple(folder / name for name in table.background if not isinstance(table.background, str))
        of_frames = table.background == "minimum"
        mask = folder / table.mask if isinstance(table.mask, str) else table.mask
        targets = [folder / plane.image for plane in self.calibration.planes] if self.calibration else []
        named = (white, dark, *background, mask if isinstance(mask, Path) else None, *targets)
        others = [path for path in named if path is not None]
        if table.pairs is None:
            assert table.frames is not None
            frames, pairs = sequence(folder, table.frames, others), Pairs()
        else:
            frames, pairs = pairs_of(folder, table.pairs, table.stacked, others)
        sensor, dt_s, orientation = self.camera().sensor, table.dt_s, table.orientation
        return Recording(sensor, frames, white, dt_s, orientation, pairs, dark, background, of_frames, mask)

    def _check_names(self) -> None:
        """Raise PlenoPIVError where the way from the results to the images is no UTF-8, in which TOML is written."""
        try:
            way = os.path.relpath(os.path.realpath(self.folder), os.path.realpath(self.output_directory))
        except ValueError:  # another drive
            return
        if any("\ud800" <= letter <= "\udfff" for letter in way):  # bytes of another encoding
            raise PlenoPIVError(
                f"{self._path}: a folder between it and output.directory has a name that is no UTF-8 "
                f"({printable(way)}); rename it, or take an output.directory beside the experiment file"
            )

    def changed(self, **keys: Any) -> Experiment:
        """A copy with other keys, checked as a file is: ``experiment.changed(windows=[[64, 64, 16]], overlap=0.75)``.

        A key is given by its name in the file. Where several tables have it, by its dotted name,
        ``changed(**{"simulation.seed": 3})``, or its table, ``changed(simulation={"seed": 3})``, whose other keys stay.
        None takes a key, or a table, out. Paths stay relative to the same file.

        Raises:
            PlenoPIVError: as ``load`` does; or several tables have the key.
        """
        tables = self.model_dump(by_alias=True, exclude_none=True)
        try:
            changes.change(tables, keys, messages.tables_of(Experiment))
        except PlenoPIVError as error:
            raise PlenoPIVError(f"{self._path}: {error}") from None
        return Experiment.from_dict(tables, self._path)

    def __repr__(self) -> str:
        windows = ", ".join(" x ".join(map(str, window)) for window in self.correlation.windows)
        dt = self.recording_table.dt_s
        return (
            f"<Experiment {self._path}: {self.camera()!r},\n {self.grid()!r},"
            f" windows {windows} voxels, dt {dt:g} s, results in {self.output.directory}>"
        )

    __str__ = __repr__

    def on_device(self, device: str | None) -> Experiment:
        """The same on another ``compute.device``; None: this one.

        Raises:
            PlenoPIVError: there is no such kind.
        """
        if device is None or device == self.compute.device:
            return self
        tables = self.model_dump(by_alias=True, exclude_none=True)
        tables["compute"]["device"] = device
        return Experiment.from_dict(tables, self._path)

    def warnings(self) -> list[str]:
        """Warnings before a run, one line each; none of them stops the run."""
        camera = self.camera()
        unmatched = mismatch(camera) if self.calibration is None else None
        lines = [unmatched] if unmatched else []
        if self.calibration is None and self.medium is None:
            lines += in_view.warnings(self.volume, self.correlation, camera)
        return lines

    def dump_toml(self, folder: str | Path | None = None) -> str:
        """The resolved file, every default written out but what the images decide. With ``folder``, its paths are
        relative to that folder, wherever links lead to it."""
        import tomli_w

        tables = self.model_dump(by_alias=True, exclude_none=True)
        tables["correlation"]["inner_window"] = self.correlation.settings().passes[-1].window
        if folder is not None:
            here, there = self.folder.resolve(), Path(folder).resolve()  # ".." leads up from where a folder really lies

            def moved(name: str) -> str:
                try:
                    return Path(os.path.relpath(here / name, there)).as_posix()
                except ValueError:  # another drive
                    return str((here / name).resolve())

            def moved_pattern(pattern: str) -> str:
                """Names of folders in front of a pattern stay names, whatever letters they hold."""
                escaped = Path(glob.escape(str(here))) / pattern
                try:
                    return Path(os.path.relpath(escaped, glob.escape(str(there)))).as_posix()
                except ValueError:  # another drive
                    return str(escaped)

            recording, output = tables["recording"], tables["output"]
            for key in ("white", "dark"):
                if key in recording:
                    recording[key] = moved(recording[key])
            for key in ("frames", "pairs"):
                if key in recording:
                    is_pattern = isinstance(recording[key], str)
                    recording[key] = moved_pattern(recording[key]) if is_pattern else _each(recording[key], moved)
            if recording["background"] not in ("none", "minimum"):
                recording["background"] = _each(recording["background"], moved)
            if isinstance(self.recording_table.mask, str):
                recording["mask"] = moved(self.recording_table.mask)
            for plane in tables.get("calibration", {}).get("planes", ()):
                plane["image"] = moved(plane["image"])
            if self.volume.body is not None:
                tables["volume"]["body"] = moved(self.volume.body)
            output["directory"] = moved(output["directory"])
        return tomli_w.dumps(tables)


def _each(names: str | Sequence[Any], moved: Callable[[str], str]) -> Any:
    """A file name or nested lists of them, each changed."""
    return moved(names) if isinstance(names, str) else [_each(name, moved) for name in names]
