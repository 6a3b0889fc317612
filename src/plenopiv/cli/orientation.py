"""``plenopiv orientation``: how images are stored, from a letter F or a target that was moved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from numpy.typing import NDArray

from plenopiv.checks.letter import find_letter
from plenopiv.checks.orientation import Direction, how_stored, moved_between, picture_of
from plenopiv.cli.terminal import Outcome
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.experiment import Experiment
from plenopiv.recording.sources import read_image

ORIENTATION = {"as it is": "upright", "turned by 180 degrees": "sensor"}
HOW_TO = "name one image of a letter F, or a target's before and after each --moved"


def orientation(file: Path, images: Sequence[Path], moved: Sequence[Direction]) -> Outcome:
    """What ``recording.orientation`` of an experiment file must be; exit code 2 where no orientation describes it.

    Raises:
        PlenoPIVError: the file or an image cannot be used, images and motions do not go together, no letter is clear,
            or the motions cannot be measured.
    """
    experiment = Experiment.load(file)
    if len(images) != len(moved) + 1:
        raise PlenoPIVError(f"{len(images)} images and {len(moved)} times --moved do not go together; {HOW_TO}")
    if len({path.resolve() for path in images}) < len(images):
        raise PlenoPIVError(f"{images[0]}: an image is named twice; {HOW_TO}")
    pictures = _pictures(experiment, images)
    if not moved:
        letter = find_letter(pictures[0][0], str(images[0]))
        found, why = (
            [letter.turn],
            (
                f"the letter F in {images[0].name} is {_in_words(letter.turn)}"
                f" (correlation {letter.alike:.2f}; next: {letter.next_turn}, {letter.next_alike:.2f})"
            ),
        )
    else:
        motions, lines = [], []
        for k, direction in enumerate(moved):
            (a, pixel_px), (b, _) = pictures[k], pictures[k + 1]
            names = [path.name for path in images[k : k + 2]]
            motion = moved_between(a, b, pixel_px, names)
            motions.append((direction, motion))
            lines.append(
                f"moved {direction}, from {names[0]} to {names[1]} by {motion.columns_px:+.1f} px along columns,"
                f" {motion.rows_px:+.1f} px along rows (correlation {motion.correlation:.2f})"
            )
        found, why = how_stored(motions), "\n".join(lines)
    return _outcome(experiment, printable_lines(why), found)


def printable_lines(text: str) -> str:
    """Text of several lines as a terminal may show it."""
    return "\n".join(printable(line) for line in text.splitlines())


def _pictures(experiment: Experiment, images: Sequence[Path]) -> list[tuple[NDArray, float]]:
    """Of each image as it is stored, without its microlenses, evened out by the white image where there is one."""
    camera, white = experiment.camera(), None
    sensor, named = camera.sensor, experiment.recording_table.white
    if named is not None and (experiment.folder / named).is_file():
        white = read_image(experiment.folder / named, sensor)
    return [picture_of(read_image(path, sensor), camera.image_pitch_px, sensor.black_level, white) for path in images]


def _in_words(turn: str) -> str:
    return "readable as it is stored" if turn == "as it is" else f"stored {turn}"


def _outcome(experiment: Experiment, why: str, found: Sequence[str]) -> Outcome:
    """What to put into the file, or why nothing can be."""
    known = [turn for turn in found if turn in ORIENTATION]
    facts = {"stored": list(found), "orientation": None, "agrees": None, "certain": len(found) == 1}
    if not known:
        undo = "; undo that in the camera's software or before saving, and record anew"
        text = f"images are {' or '.join(found)}: no recording.orientation describes that{undo}"
        return Outcome(f"{why}\n{text}", facts, 2)
    right, stated = ORIENTATION[known[0]], experiment.recording_table.orientation
    lines = [why, f'recording.orientation = "{right}"']
    if len(found) > 1:
        others = " or ".join(turn for turn in found if turn not in ORIENTATION)
        lines.append(
            f"unless images are {others}, which one motion cannot tell: move the target across it too,"
            " or photograph an F"
        )
    name = printable(str(experiment.path))
    agrees = right == stated
    lines.append(
        f"{name}: is right" if agrees else f'{name}: says "{stated}", put "{right}" there; u and v were reversed'
    )
    return Outcome("\n".join(lines), facts | {"orientation": right, "agrees": agrees})
