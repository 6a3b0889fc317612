"""``plenopiv check`` on each fault that it must name: what the user reads, and the exit code."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from recordings import camera, copied, edited, record, white_of

from plenopiv.cli import light_field, main
from plenopiv.cli.terminal import Outcome
from plenopiv.sensor import Sensor

UNUSABLE, WARNED = 2, 0


def good(recorded, folder):
    return copied(recorded(), folder)


def lattice_type(recorded, folder):
    file = good(recorded, folder) / "experiment.toml"
    file.write_text(file.read_text().replace('lattice = "hexagonal"', 'lattice = "square"'))


def f_numbers(recorded, folder):
    record(folder, of=camera(aperture=0.85))


def exposed(electrons):
    return lambda recorded, folder: record(folder, electrons_per_pixel=electrons)


def dense(recorded, folder):
    record(folder, particles_per_microlens=7.0, electrons_per_pixel=150.0)


def turned(names, turn, square=False):
    """Images saved another way than the others; ``square``: on a sensor that a quarter turn leaves its shape."""

    def spoil(recorded, folder):
        if square:
            record(folder, of=replace(camera(), sensor=Sensor(364, 364, 0.0055, 12, 60)))
        else:
            good(recorded, folder)
        for name in names:
            edited(folder, name, turn)

    return spoil


def other_camera(recorded, folder):
    edited(
        good(recorded, folder), "white", lambda image: white_of(camera(rotation_rad=0.021, offset_mm=(-0.03, 0.005)))
    )


def out_of_order(recorded, folder):
    good(recorded, folder)
    for name, second in (("a", 1), ("b", 0)):
        edited(folder, name, lambda image: image, datetime=f"2026:03:02 10:00:0{second}")


FLIPPED = "the white image fits a.tif only {}: one of them was saved turned or mirrored -> save white image and frames"
FAULTS = {
    "wrong lattice type": (lattice_type, UNUSABLE, 'shows a hexagonal lattice', 'set it to "hexagonal"'),
    "f-number mismatch": (
        f_numbers, WARNED, "f-numbers do not match", "leave dark pixels between them", "-> open the main lens to",
    ),
    "overexposed": (exposed(60000.0), UNUSABLE, "a.tif is overexposed: ", "pixels are at full scale -> less light"),
    "underexposed": (exposed(6.0), UNUSABLE, "a.tif is underexposed: a particle in focus gives", "-> more light"),
    "rather dark": (exposed(15.0), WARNED, "a.tif is underexposed: a particle in focus gives", "-> more light"),
    "too dense": (dense, WARNED, "seeding is too dense: about", "-> dilute to"),
    "white image mirrored": (
        turned(["white"], np.fliplr), UNUSABLE, FLIPPED.format("mirrored left to right"),
    ),
    "white image upside down": (
        turned(["white"], np.flipud), UNUSABLE, FLIPPED.format("mirrored top to bottom"),
    ),
    "frames turned by 180 degrees": (
        turned(["a", "b"], lambda image: image[::-1, ::-1]), UNUSABLE, FLIPPED.format("turned by 180 degrees"),
    ),
    "white image turned by 90 degrees": (
        turned(["white"], np.rot90, square=True), UNUSABLE, FLIPPED.format("turned by 90 degrees clockwise"),
    ),
    "white image of another camera": (
        other_camera, UNUSABLE, "in no orientation nearer: it is another camera's", "-> take a new white image",
    ),
    "frames out of order": (
        out_of_order, UNUSABLE, "frames are out of order by their times: b.tif was taken 1 s before a.tif",
        "-> name them in the order of time in recording.frames",
    ),
}  # fmt: skip


# of the full set: their like is among the others, and they are found in test_faults
LATER = (
    "f-number mismatch",
    "rather dark",
    "too dense",
    "overexposed",
    "white image upside down",
    "white image turned by 90 degrees",
    "white image of another camera",
)


@pytest.mark.parametrize("fault", [pytest.param(n, marks=pytest.mark.full) if n in LATER else n for n in FAULTS])
def test_a_fault_is_named_with_advice_and_the_exit_code_says_whether_to_go_on(
    recorded, tmp_path, capsys, monkeypatch, fault
):
    monkeypatch.setattr(light_field, "_drawn", lambda *drawn: Outcome(""))  # the picture has tests of its own
    spoil, code, *phrases = FAULTS[fault]
    spoil(recorded, tmp_path / "recording")
    file = tmp_path / "recording" / "experiment.toml"
    assert main(["check", str(file)]) == code
    *lines, verdict = capsys.readouterr().out.strip().splitlines()
    text = " ".join(" ".join(lines).split())
    for phrase in phrases:
        assert phrase in text
    worst = {line.split()[0] for line in lines if line.strip() and not line.startswith(" ")}
    assert worst <= {"good", "warning", "unusable"}
    assert ("unusable" in worst) == (code == UNUSABLE)
    assert "warning" in worst or code == UNUSABLE
    assert verdict.startswith(f"{file}: ")
    assert verdict.endswith("not usable as it is" if code == UNUSABLE else "usable, 1 to look at")


def test_a_good_recording_ends_with_zero(recorded, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(light_field, "_drawn", lambda *drawn: Outcome(""))
    file = good(recorded, tmp_path / "recording") / "experiment.toml"
    assert main(["check", str(file)]) == 0
    *lines, verdict = capsys.readouterr().out.strip().splitlines()
    assert {line.split()[0] for line in lines if line.strip() and not line.startswith(" ")} == {"good"}
    assert verdict == f"{file}: good"


@pytest.mark.full
def test_all_frames_are_read_where_asked(recorded, tmp_path, capsys):
    """The second of three pairs is spoilt: a sample passes it by, --all does not."""
    folder = tmp_path / "pairs"
    good(recorded, folder)
    for k in (1, 2, 3):
        for pulse in "ab":
            shutil.copy(folder / f"{pulse}.tif", folder / f"p{k}_{pulse}.tif")
    image = tifffile.imread(folder / "p2_b.tif")
    tifffile.imwrite(folder / "p2_b.tif", np.ascontiguousarray(image[:, ::-1]))
    file = folder / "experiment.toml"
    file.write_text(re.sub(r"frames = \[[^\]]*\]", 'pairs = "p*_{a,b}.tif"', file.read_text()))
    assert main(["check", str(file), "--all"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "p2_b.tif only mirrored left to right" in out
    assert "(1 of 3 pairs)" in out
    assert "a run sets such pairs aside" in out
