"""What a case is: a copy of a recording, to be spoilt, and what the program may then do.

``Copy`` has the images and the keys of the experiment file."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from small_recording import CAMERA, NOISE, Clean, Counts

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.simulation.sensor_noise import digitise
from plenopiv.simulation.white import white_image

SENSOR = CAMERA.sensor
BLACK = SENSOR.black_level
WHITE_ELECTRONS = 5000.0
WAVELENGTH_NM = 532.0
FILES = "experiment.toml"
MIDDLE = 2  # the pair that is spoilt where one is
ROW, COLUMN = np.mgrid[: SENSOR.rows, : SENSOR.columns].astype(float)


def spot(counts: float, row: float, column: float, sigma_px: float) -> Counts:
    """A Gaussian spot of light, counts."""
    return counts * np.exp(-((ROW - row) ** 2 + (COLUMN - column) ** 2) / (2 * sigma_px**2))


GLOW = spot(250.0, 200, 250, 120.0)
REFLECTION = spot(900.0, 450, 600, 12.0)
SATURATED_REFLECTION = spot(12000.0, 450, 600, 12.0)


def dimmed(counts: Counts, factor: float, rng: np.random.Generator) -> Counts:
    """Counts of a part of the light; noise is added to what is left, so that it is that of less light."""
    light, read_noise = np.maximum(counts - BLACK, 0.0), NOISE.gain * NOISE.read_noise_electrons
    variance = (factor - factor**2) * NOISE.gain * light + (1 - factor**2) * read_noise**2
    return BLACK + factor * (counts - BLACK) + np.sqrt(variance) * rng.standard_normal(counts.shape)


def read(path: Path) -> Counts:
    """Counts of a TIFF file, for arithmetic."""
    return tifffile.imread(path).astype(float)


def write(path: Path, counts: NDArray, **options: Any) -> None:
    """Counts as the sensor holds them, rounded and cut off at full scale; or other integers as they are."""
    if counts.dtype.kind == "f":
        counts = np.clip(np.rint(counts), 0, SENSOR.full_scale).astype(np.uint16)
    tifffile.imwrite(path, counts, **options)


@dataclass
class Copy:
    """A copy of the first ``pairs`` pairs, and the tables of its experiment file, which ``save`` writes."""

    clean: Clean
    folder: Path
    pairs: int
    seed: int
    tables: dict[str, Any] = field(init=False)
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True)
        for name in ("white.tif", "dark.tif"):
            shutil.copy(self.clean.folder / name, self.folder)
        for path in (self.clean.folder / path.name for path in self.frames()):
            shutil.copy(path, self.folder)
        self.tables = tomllib.loads((self.clean.folder / FILES).read_text())
        self.rng = np.random.default_rng(self.seed)

    def frame(self, pair: int, pulse: str) -> Path:
        """A frame's file; pairs are counted from 0."""
        return self.folder / f"run_{pair + 1:02d}_{pulse}.tif"

    def frames(self, pulses: str = "ab", pairs: Iterable[int] | None = None) -> list[Path]:
        """The frames' files, those of the named pulses and pairs."""
        return [self.frame(pair, pulse) for pair in (range(self.pairs) if pairs is None else pairs) for pulse in pulses]

    @property
    def white(self) -> Path:
        """The white image."""
        return self.folder / "white.tif"

    def change(
        self, function: Callable[[Counts], Counts], pulses: str = "ab", pairs: Iterable[int] | None = None
    ) -> None:
        """Change the counts of frames, all of them or those of the named pulses and pairs."""
        for path in self.frames(pulses, pairs):
            write(path, function(read(path)))

    def add(self, light: Counts, pulses: str = "ab", pairs: Iterable[int] | None = None) -> None:
        """Light beside that of the particles, mean counts, with shot noise of its own."""
        gain = NOISE.gain
        self.change(lambda counts: counts + gain * self.rng.poisson(light / gain), pulses, pairs)

    def another_white(self, camera: PlenopticCamera) -> None:
        """A white image of another camera, its counts those of this one's sensor."""
        light = white_image(camera, WHITE_ELECTRONS, diffraction_nm=WAVELENGTH_NM)
        write(self.white, digitise(light, camera.sensor, NOISE, self.rng))

    def lattice(self, **changes: Any) -> PlenopticCamera:
        """The camera with another lattice."""
        return CAMERA.with_lattice(replace(CAMERA.lattice, **changes))

    def key(self, name: str, value: Any) -> None:
        """State a key of the experiment file otherwise; None leaves it out."""
        *path, last = name.split(".")
        table = self.tables
        for part in path:
            table = table[part]
        if value is None:
            del table[last]
        else:
            table[last] = value

    def times(self, name: str, factor: float) -> None:
        """Multiply a key of the experiment file."""
        *path, last = name.split(".")
        table = self.tables
        for part in path:
            table = table[part]
        table[last] *= factor

    def stamp(self, path: Path, seconds: float) -> None:
        """Write a time into a file's tags."""
        text, fraction = "2026:03:02 10:00:00", f"{seconds:.6f}".partition(".")[2]
        tags = [(36867, "s", 0, text, True), (37521, "s", 0, fraction, True)]
        write(path, tifffile.imread(path), extratags=tags)

    def save(self) -> Path:
        """Write the experiment file."""
        import tomli_w

        path = self.folder / FILES
        path.write_text(tomli_w.dumps(self.tables))
        return path


Spoil = Callable[[Copy], object]


@dataclass(frozen=True)
class Case:
    """A recording and what is wrong with it.

    ``base``: which clean recording is copied (``small_recording``, spoilt.py), and how many of its ``pairs``. ``bad``:
    the pairs, counted from 0, that alone are spoilt; empty where the whole recording is. ``fine``: measured as if
    unspoilt without any warning; ``silent``: nothing tells it, and it may be wrong. ``says``: a regular expression, of
    warnings of the run that name the cause too.
    """

    what: str
    spoil: Spoil
    causes: tuple[str, ...] = ()
    says: str = field(default="$^", kw_only=True)
    bad: tuple[int, ...] = ()
    silent: bool = False
    fine: bool = False
    base: str = "clean"
    pairs: int = 4
