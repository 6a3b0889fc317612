"""Which mutants the campaign tries: seven named ones, and some drawn by a seed from the measuring chain, area by area.

Files move while the project changes, so areas are patterns. The draw orders the spots of an area by a hash of seed,
file name, function, kind and number: an edit elsewhere does not change what is drawn.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import mutants
from mutants import KINDS
from spot_finder import Edit

SEED, COUNT = 2016, 60
PACKAGE = "src/plenopiv"

AREAS = {
    "geometry": ("optics.py", "lattice.py", "cameras/**/*.py", "projection/**/geometry.py"),
    "weights": ("projection/**/cell_areas.py", "projection/**/pixel_weights.py", "projection/**/plane_maps/**/*.py"),
    "MART": ("reconstruction/mart.py", "reconstruction/thinning.py", "projection/correction.py"),
    "candidates": ("reconstruction/candidates.py", "projection/**/candidates/**/*.py"),
    "correlation": ("displacement/**/*.py",),
    "error bars": ("displacement/**/uncertainty.py", "displacement/**/noise_amplification.py"),
    "units": ("velocity.py", "volume.py", "lightfield.py"),
}  # a file belongs to the last area that names it

# Where a mutant is most likely to be caught, tried first: a pattern of files, and folders of tests in turn.
NEAREST = [
    ("optics.py", ("optics", "cameras", "lightfield")),
    ("lattice.py", ("lattice", "lightfield")),
    ("cameras/**/*.py", ("cameras", "optics", "lightfield", "projection")),
    ("projection/**/*.py", ("projection", "reconstruction")),
    ("reconstruction/**/*.py", ("reconstruction", "projection")),
    ("displacement/**/*.py", ("displacement",)),
    ("velocity.py", ("velocity",)),
    ("volume.py", ("volume", "reconstruction")),
    ("lightfield.py", ("lightfield", "refocusing", "projection")),
    ("refocusing.py", ("refocusing",)),
    ("run/**/*.py", ("run",)),
]

# Name, file, what is written there, and what is written instead.
NAMED = [
    (
        "outlier threshold doubled",
        "displacement/settings.py",
        "outlier_threshold: float = 3.0",
        "outlier_threshold: float = 6.0",
    ),
    (
        "lens phase ignored in refocusing",
        "refocusing.py",
        "phase = where.phase[np.maximum(nearest, 0)]",
        "phase = 0 * where.phase[np.maximum(nearest, 0)]",
    ),
    ("LIT_SHARE 0.5 to 0.2", "lightfield.py", "LIT_SHARE = 0.5", "LIT_SHARE = 0.2"),
    ("FOREIGN_SHARE times 10", "lightfield.py", "FOREIGN_SHARE = 0.001", "FOREIGN_SHARE = 0.01"),
    (
        "smoothing of volumes to 0.3",
        "displacement/settings.py",
        "smoothing_voxels: float | Sides = (1.0, 1.0, 0.8)",
        "smoothing_voxels: float | Sides = 0.3",
    ),
    ("ACROSS 7 to 3", "projection/plenoptic/plane_maps/maps.py", "ACROSS = 7.0", "ACROSS = 3.0"),
    (
        "predicted time divided by ten",
        "run/duration.py",
        "TimeEstimate(frame / threads, pair / threads, START",
        "TimeEstimate(frame / threads / 10, pair / threads / 10, START",
    ),
]


class PlanError(Exception):
    """A pattern or a named text that the sources no longer hold; one line."""


@dataclass(frozen=True)
class Mutant:
    """``key``: its name, stable while the function stays. ``file``: from the root of the repository. ``line``, ``was``,
    ``becomes``: the changed line. ``source``: hash of the mutated function, for which alone a result holds."""

    key: str
    area: str
    kind: str
    file: str
    edit: Edit
    line: int
    was: str
    becomes: str
    source: str


def files_of(root: Path) -> dict[str, list[Path]]:
    """The files of every area. Raises ``PlanError`` where a pattern finds none."""
    owner: dict[Path, str] = {}
    for area, patterns in AREAS.items():
        for pattern in patterns:
            found = [path for path in (root / PACKAGE).glob(pattern) if path.name != "__init__.py"]
            if not found:
                raise PlanError(
                    f"area {area}: no file is called {PACKAGE}/{pattern}; correct AREAS in mutation_plan.py"
                )
            owner |= dict.fromkeys(found, area)
    return {area: sorted(path for path, its in owner.items() if its == area) for area in AREAS}


def nearest(root: Path, mutant: Mutant) -> list[str]:
    """Folders of tests to begin with, those that there are."""
    path = Path(mutant.file).relative_to(PACKAGE)
    for pattern, folders in NEAREST:
        if path in {found.relative_to(root / PACKAGE) for found in (root / PACKAGE).glob(pattern)}:
            return [f"tests/{name}" for name in folders if (root / "tests" / name).is_dir()]
    return []


def named(root: Path) -> list[Mutant]:
    """The named mutants. Raises ``PlanError`` where a text is not found exactly once."""
    found = []
    for key, file, old, new in NAMED:
        path = root / PACKAGE / file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if text.count(old) != 1:
            raise PlanError(f"{key}: '{old}' is not once in {PACKAGE}/{file}; correct NAMED in mutation_plan.py")
        edit = Edit(text.index(old), text.index(old) + len(old), new)
        line, was, becomes = mutants.changed_line(text, edit)
        found.append(
            Mutant(key, "named", "named", f"{PACKAGE}/{file}", edit, line, was, becomes, mutants.digest(becomes))
        )
    return found


def of_file(root: Path, path: Path, area: str) -> list[Mutant]:
    """All mutants of a file."""
    text, found = path.read_text(encoding="utf-8"), []
    for spot in mutants.spots(text):
        name = path.relative_to(root / PACKAGE).as_posix()
        key = f"{name}:{spot.function}:{spot.kind}:{spot.number}"
        source = mutants.digest(mutants.function_source(text, spot))
        change = mutants.changed_line(text, spot.edit)
        found.append(Mutant(key, area, spot.kind, f"{PACKAGE}/{name}", spot.edit, *change, source))
    return found


def in_turn(root: Path, area: str, files: list[Path], seed: int) -> Iterator[Mutant]:
    """All mutants of an area, kinds taking turns, each kind in the order that the seed gives."""

    def order(mutant: Mutant) -> str:
        folder, _, rest = mutant.key.rpartition("/")
        return mutants.digest(f"{seed}:{rest}") + folder

    every = sorted((m for path in files for m in of_file(root, path, area)), key=order)
    queues = [[m for m in every if m.kind == kind] for kind in KINDS]
    while any(queues):
        for queue in queues:
            if queue:
                yield queue.pop(0)


def shares(count: int) -> dict[str, int]:
    """How many mutants each area gets: all alike, the first ones one more."""
    each, more = divmod(count, len(AREAS))
    return {area: each + (n < more) for n, area in enumerate(AREAS)}


class Plan:
    """The mutants of a campaign; those that cannot be imported give way to the next ones of their area."""

    def __init__(self, root: Path, seed: int = SEED, count: int = COUNT):
        files, self.root = files_of(root), root
        self._draws = {area: in_turn(root, area, files[area], seed) for area in AREAS}
        self.drawn = [m for area, share in shares(count).items() for m in islice(self._draws[area], share)]
        self.named = named(root)

    @property
    def mutants(self) -> list[Mutant]:
        """The named ones, then those drawn."""
        return [*self.named, *self.drawn]

    def replace(self, mutant: Mutant) -> Mutant | None:
        """The next one of its area in place of a mutant that is none; None after the last."""
        place = self.drawn.index(mutant)
        following = next(self._draws[mutant.area], None)
        self.drawn[place : place + 1] = [following] if following else []
        return following
