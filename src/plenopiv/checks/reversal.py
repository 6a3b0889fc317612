"""Whether a recording that is read as a sequence is one: frames of pairs, taken one after the other, give every second
field reversed, or of two instants that have nothing in common.

The names of the files may say so, and the frames do: in the middle of the sensor, particles of each frame are
correlated with those of the next as in ``motion``, in windows of a third of the depth, with fewer views and planes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.checks import motion
from plenopiv.checks.findings import Finding
from plenopiv.errors import printable
from plenopiv.lightfield import decode, layout
from plenopiv.recording import Recording
from plenopiv.recording.naming import looks_like_pairs
from plenopiv.refocusing import image_axes
from plenopiv.sensor import middle, middle_of

SIDE_PX = 640  # of the sensor's middle
FRAMES = 5  # the first of the recording
EVERY = 9  # of the views
SLABS = 3  # of the depth, in which particles move alike
FOUND = 0.22  # median correlation coefficient: same particles have 0.29 to 0.65 here, others 0.11 to 0.19
CHANCE = 0.62  # of the strongest step: where those below alternate with those above, they have no particles in common
LOST = 0.75  # of the weakest step that is found, below which another has no particles in common
MOVES = 0.6  # microlenses by which two steps must differ, before it counts
ALIKE = 0.35  # of the difference of two steps by which what is equal may differ
MOST = 2 / 3  # of the windows

Steps = tuple["Step", ...]


@dataclass(frozen=True)
class Step:
    """From one frame to the next: displacements (n, 3) of all windows along x, y, z, in microlenses across and dead
    zones in depth, and their correlation coefficients (n,)."""

    displacement: NDArray[np.float64]
    correlation: NDArray[np.float64]

    @property
    def strength(self) -> float:
        """Median correlation coefficient."""
        return float(np.median(self.correlation))


def of_names(recording: Recording) -> Finding | None:
    """A finding where a sequence has names of pairs."""
    found = looks_like_pairs(file_names(recording)) if recording.is_sequence else None
    if found is None:
        return None
    first, second = found.pairs[0]
    return Finding(
        "pairs-as-sequence",
        "unusable",
        f"by their names frames are pairs ({printable(first)} and {printable(second)}), and they are read as one "
        "sequence: every second field would be of two pairs",
        float(len(found.pairs)),
        "pairs",
        _advice(found.pattern),
    )


def of_frames(recording: Recording, camera: PlenopticCamera, z_mm: tuple[float, float]) -> Finding | None:
    """What the first frames of a sequence say; ``camera``: with the lattice of the white image.

    Raises:
        PlenoPIVError: a frame cannot be read.
    """
    if not recording.is_sequence or len(recording) < 3:
        return None
    named, files = looks_like_pairs(file_names(recording)), {frame.path.name for frame in recording.frames}
    pattern = named.pattern if named is not None else next(iter(files)) if len(files) == 1 else ""
    return finding(steps(recording, camera, z_mm), pattern)


def steps(recording: Recording, camera: PlenopticCamera, z_mm: tuple[float, float]) -> Steps:
    """Displacements between the first frames of a recording."""
    part = middle(recording.sensor, SIDE_PX, SIDE_PX)
    where = layout(replace(camera, sensor=part))
    lens = camera.lattice.pitch_mm / abs(camera.main_lens.magnification)
    near, far = camera.dead_zone_mm()
    planes = int(np.clip(round((z_mm[1] - z_mm[0]) / (far - near)) + 1, 2 * SLABS, motion.PLANES))
    z = np.linspace(*z_mm, planes)
    x, y = image_axes(where.camera, lens / motion.STEPS)
    y = y[::-1]
    windows = [
        (slice(slab[0], slab[-1] + 1), rows, columns)
        for slab in np.array_split(np.arange(planes), SLABS)
        for rows in motion.parts(y.size)
        for columns in motion.parts(x.size)
    ]
    scale = np.array([1 / motion.STEPS, 1 / motion.STEPS, (z[1] - z[0]) / (far - near)])
    found: list[Step] = []
    before = None
    for k in range(min(len(recording), FRAMES)):
        light, _ = recording.light(k)
        pictures = motion.stack(decode(middle_of(light, part), where), x, y, z, EVERY)
        if before is not None:
            moved = [motion.moved(before[window], pictures[window]) for window in windows]
            found.append(Step(scale * [move[::-1] for move, _ in moved], np.array([peak for _, peak in moved])))
        before = pictures
    return tuple(found)


def finding(found: Steps, pattern: str = "") -> Finding | None:
    """The finding on successive steps; None where they tell nothing. ``pattern``: of pairs, if the names say one."""
    strengths = [step.strength for step in found]
    weakest = min((s for s in strengths if s >= FOUND), default=np.inf)
    seen = [s >= FOUND for s in strengths]
    strong = [s > CHANCE * max(strengths) for s in strengths]
    if _alternates(strong) and any(s >= FOUND for s in strengths):
        seen = strong
        weakest = min(s for s, found_here in zip(strengths, strong, strict=True) if found_here)
    if any(not s and strength > LOST * weakest for s, strength in zip(seen, strengths, strict=True)):
        return None  # neither found nor lost
    shares = ", ".join(f"{s:.2f}" for s in strengths)
    if any(seen) and _alternates(seen):
        words = f"only every second frame has particles in common with the next one (correlations {shares})"
        return _bad(words, len(seen) > 3 or seen[0], pattern)
    if not all(seen) or len(seen) < 2:
        return None
    moves = ", ".join("({:+.1f}, {:+.1f}, {:+.1f})".format(*np.median(step.displacement, axis=0)) for step in found)
    where = f"{moves} microlenses across and half dead zones in depth"
    differ = [_share(_differ(a, b)) for a, b in pairwise(found)]
    if len(found) > 2:
        again = [_share(_back(a, b, c)) for a, b, c in zip(found, found[1:], found[2:], strict=False)]
        if min(differ) >= MOST and min(again) >= MOST:
            return _bad(f"displacements of successive frames alternate: {where}", True, pattern)
    elif _share(_opposite(*found)) >= MOST:
        return _bad(f"successive displacements are opposite: {where}", False, pattern)
    if max(differ) > 1 - MOST:
        return None
    return Finding("reversing", "good", f"successive displacements agree over {len(found) + 1} frames", max(differ))


def _alternates(seen: Sequence[bool]) -> bool:
    """Whether every second one of three and more is true."""
    return len(seen) > 2 and all(a != b for a, b in pairwise(seen))


def _differ(a: Step, b: Step) -> NDArray[np.bool_]:
    """Windows in which two steps are not the same."""
    return _size(a.displacement - b.displacement) > MOVES


def _back(a: Step, b: Step, c: Step) -> NDArray[np.bool_]:
    """Windows in which the third step is the first one again, and the second is not."""
    off = _size(b.displacement - 0.5 * (a.displacement + c.displacement))
    return (off > MOVES) & (_size(a.displacement - c.displacement) < ALIKE * off)


def _opposite(a: Step, b: Step) -> NDArray[np.bool_]:
    """Windows in which the second step is the first one reversed."""
    difference = _size(a.displacement - b.displacement)
    return (difference > MOVES) & (_size(a.displacement + b.displacement) < ALIKE * difference)


def _size(displacement: NDArray) -> NDArray[np.float64]:
    return np.linalg.norm(displacement, axis=1)


def _share(windows: NDArray[np.bool_]) -> float:
    return float(np.mean(windows))


def _bad(words: str, sure: bool, pattern: str) -> Finding:
    """Frames of pairs, read as a sequence."""
    words = f"{words}: pairs of a double-frame camera, read as one sequence?"
    return Finding("reversing", "unusable" if sure else "warning", words, advice=_advice(pattern))


def _advice(pattern: str) -> str:
    line = (
        f'pairs = "{printable(pattern)}" (names without their folder)' if pattern else 'pairs, as in "run_*_{a,b}.tif",'
    )
    return f"write {line} instead of frames in [recording]; dt_s is the time between the two of a pair"


def file_names(recording: Recording) -> Sequence[str]:
    """Names of the frames, with the folder where there are several, or none where files hold several images."""
    if any(frame.pages > 1 or frame.half or frame.dataset for frame in recording.frames):
        return ()
    folders = {frame.path.parent for frame in recording.frames}
    if len(folders) == 1:
        return [frame.path.name for frame in recording.frames]
    top = {frame.path.parent.parent for frame in recording.frames}
    return [f"{frame.path.parent.name}/{frame.path.name}" for frame in recording.frames] if len(top) == 1 else ()
