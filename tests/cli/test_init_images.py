"""plenopiv init: what the images of a folder are taken for, and commands that can be pasted."""

import json
import shlex
from pathlib import Path

import h5py
import imagecodecs
import numpy as np
import pytest
import tifffile
from drafted_recording import COLUMNS, ROWS, SHEET

from plenopiv.cli import main
from plenopiv.experiment import Experiment

RNG = np.random.default_rng(3)


def counts(images=1, rows=ROWS):
    shape = (rows, COLUMNS) if images == 1 else (images, rows, COLUMNS)
    return RNG.integers(60, 900, shape).astype(np.uint16)


def save(path, image):
    kinds = {".tif": tifffile.imwrite, ".npy": np.save, ".png": lambda p, i: p.write_bytes(imagecodecs.png_encode(i))}
    options = {"photometric": "minisblack"} if path.suffix == ".tif" and image.ndim == 3 else {}
    kinds[path.suffix](path, image, **options)


@pytest.fixture
def drafted(tmp_path, capsys):
    """Make a folder of these files, draft its experiment file, and load it: (experiment, lines of the terminal)."""

    def draft(names, images=1, rows=ROWS, folder="run7", others=("white.tif",)):
        at = tmp_path / folder
        at.mkdir(parents=True, exist_ok=True)
        for name in others:
            save(at / name, counts())
        for name in names:
            save(at / name, counts(images, rows))
        (tmp_path / "optics.json").write_text(json.dumps(SHEET))
        assert main(["init", str(at), str(tmp_path / "optics.json")]) == 0
        experiment = Experiment.load(at / "experiment.toml")
        return experiment, capsys.readouterr().out.splitlines()

    return draft


def line(lines, what):
    """What was taken for something; "" where nothing was."""
    return "; ".join(text.split(maxsplit=1)[1] for text in lines if text.startswith(f"  {what}  "))


NAMINGS = {
    "B{k:05}_{p}.tif": ("AB", "B*_{A,B}.tif"),
    "img{k:03}{p}.tif": ("ab", "img*{a,b}.tif"),
    "run_{k:03}_{p}.tif": ("12", "run_*_{1,2}.tif"),
    "run_{k:03}_La{p}.tif": ("01", "run_*_La{0,1}.tif"),
    "{k}_frame{p}.npy": ("AB", "*_frame{A,B}.npy"),
    "jet {k} {p}.png": (("first", "second"), "jet * {first,second}.png"),
    "run [{k}]_{p}.tif": ("ab", None),
}


@pytest.mark.parametrize("form", NAMINGS)
def test_double_frames_become_pairs(drafted, form):
    pulses, pattern = NAMINGS[form]
    expected = [tuple(form.format(k=k, p=p) for p in pulses) for k in (1, 2, 11)]
    experiment, lines = drafted([name for pair in expected for name in pair])
    table = experiment.recording_table
    assert table.frames is None
    assert table.pairs == (pattern or tuple(expected))
    recording = experiment.recording()
    assert [(recording.names[a], recording.names[b]) for a, b in recording.pairs] == expected
    first, last = (" + ".join(pair) for pair in (expected[0], expected[-1]))
    assert line(lines, "pairs") == f"3 of a double-frame camera, {first} to {last}"
    assert "between the two frames of a pair" in experiment.path.read_text()


@pytest.mark.parametrize("names", [("frame_1.tif", "frame_2.tif", "frame_3.tif"), ("img_1.tif", "img_2.tif")])
def test_numbered_files_stay_a_sequence(drafted, names):
    experiment, lines = drafted(names)
    assert experiment.recording_table.frames == names
    assert experiment.recording().is_sequence
    assert line(lines, "frames").startswith(f"{len(names)}, a sequence: ")
    assert not line(lines, "pairs")


def test_dark_background_and_what_is_no_frame(drafted):
    pairs = [f"run_{k:04}_{p}.tif" for k in (1, 2, 3) for p in "ab"]
    others = ["white.tif", "dark_1.tif", "dark_2.tif", "background_a.tif", "background_b.tif", "overview.tif"]
    targets = [f"target_{k:02}.tif" for k in range(4)]
    experiment, lines = drafted(pairs, others=[*others, *targets, "mask.png"])
    table = experiment.recording_table
    assert table.pairs == "run_*_{a,b}.tif"
    assert (table.white, table.dark) == ("white.tif", "dark_1.tif")
    assert table.background == ("background_a.tif", "background_b.tif")
    assert line(lines, "background") == "background_a.tif + background_b.tif, one for each pulse"
    assert line(lines, "dark") == "dark_1.tif"
    unused = line(lines, "not used")
    for name in ("dark_2.tif", "overview.tif", "target_00.tif to target_03.tif (4 files)", "mask.png"):
        assert name in unused
    assert len(experiment.recording()) == 6
    assert experiment.recording().static_light is not None


def test_one_background_of_a_sequence(drafted):
    experiment, lines = drafted(["f1.tif", "f2.tif", "f3.tif"], others=["run_white.tif", "bg_a.tif", "bg_b.tif"])
    assert experiment.recording_table.white == "run_white.tif"
    assert experiment.recording_table.background == ("bg_a.tif",)
    assert "bg_b.tif" in line(lines, "not used")


def test_pages_of_two_are_pairs_and_of_many_a_sequence_with_the_other_reading_beside(drafted):
    experiment, lines = drafted(["run_1.tif", "run_2.tif"], images=2)
    assert experiment.recording_table.pairs == "run_*.tif"
    assert experiment.recording().pairs == ((0, 1), (2, 3))
    assert 'write frames = "run_*.tif" instead of pairs' in line(lines, "pairs")
    assert "# if they are one sequence" in experiment.path.read_text()

    experiment, lines = drafted(["film.tif"], images=6, folder="film")
    assert experiment.recording_table.frames == "film.tif"
    assert len(experiment.recording().pairs) == 5
    assert 'write pairs = "film.tif" instead of frames' in line(lines, "frames")
    experiment.path.write_text(experiment.path.read_text().replace('frames = "film.tif"', 'pairs = "film.tif"'))
    assert len(Experiment.load(experiment.path).recording().pairs) == 3


def test_images_of_double_height_hold_both_pulses(drafted):
    experiment, lines = drafted(["r1.tif", "r2.tif"], rows=2 * ROWS)
    assert experiment.recording_table.stacked == "top-first"
    assert experiment.camera().sensor.rows == ROWS
    assert experiment.recording().names == ["r1.tif top", "r1.tif bottom", "r2.tif top", "r2.tif bottom"]
    assert 'write stacked = "bottom-first"' in line(lines, "pairs")
    single, _ = drafted(["r1.tif"], rows=2 * ROWS, folder="one")
    assert single.recording().pairs == ((0, 1),)


def test_data_sets_of_one_hdf5_file(tmp_path, capsys):
    with h5py.File(tmp_path / "rec.h5", "w") as file:
        file["camera/frames"] = counts(4)
        file["camera/white"] = counts()
        file["camera/dark"] = counts()
        file["camera/time"] = np.arange(4.0)
    (tmp_path / "optics.json").write_text(json.dumps(SHEET))
    assert main(["init", str(tmp_path), str(tmp_path / "optics.json")]) == 0
    experiment = Experiment.load(tmp_path / "experiment.toml")
    assert experiment.recording_table.frames == "rec.h5::camera/frames"
    assert experiment.recording_table.dark == "rec.h5::camera/dark"
    assert len(experiment.recording()) == 4
    assert "rec.h5::camera/white" in line(capsys.readouterr().out.splitlines(), "white")


@pytest.mark.parametrize(("rows", "told"), [(2 * ROWS, True), (ROWS, False)])
def test_a_white_image_of_double_height_without_the_sensors_rows(tmp_path, capsys, rows, told):
    """Nothing says that these are two each but their shape."""
    for name in ("white.tif", "f1.tif", "f2.tif"):
        save(tmp_path / name, counts(rows=rows))
    sheet = json.loads(json.dumps(SHEET))
    for side in ("rows", "columns"):
        sheet["sensor"].pop(side, None)
    (tmp_path / "optics.json").write_text(json.dumps(sheet))
    assert main(["init", str(tmp_path), str(tmp_path / "optics.json")]) == 0
    assert ("do they hold two each, one above the other?" in capsys.readouterr().out) == told


def hdf5_recording(folder, **data):
    with h5py.File(folder / "rec.h5", "w") as file:
        file["white"] = counts()
        for name, values in data.items():
            file[name] = values
    (folder / "optics.json").write_text(json.dumps(SHEET))


def test_pulses_in_two_data_sets(tmp_path, capsys):
    hdf5_recording(tmp_path, pulse_a=counts(3), pulse_b=counts(3))
    assert main(["init", str(tmp_path), str(tmp_path / "optics.json")]) == 0
    assert "3 of a double-frame camera, the images of rec.h5::pulse_a with those of rec.h5::pulse_b" in line(
        capsys.readouterr().out.splitlines(), "pairs"
    )
    recording = Experiment.load(tmp_path / "experiment.toml").recording()
    assert recording.pairs == ((0, 1), (2, 3), (4, 5))
    assert recording.names[2:4] == ["rec.h5::pulse_a page 2", "rec.h5::pulse_b page 2"]


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ({"frames": np.zeros((4, ROWS, 280), np.int32)}, "rec.h5::frames holds int32 values; write 8- or 16-bit"),
        (
            {"images": np.zeros((4, 2, ROWS, 280), np.uint16)},
            "rec.h5::images has 4 axes; write (images, rows",
        ),
        ({"one": counts(3), "two": counts(3)}, "rec.h5::two is another data set; store all images in data sets of one"),
    ],
)
def test_data_sets_that_are_no_frames_are_named(tmp_path, one_line, data, expected):
    hdf5_recording(tmp_path, **data)
    assert expected in one_line("init", tmp_path, tmp_path / "optics.json")


@pytest.mark.parametrize("name", ["white", "dark", "background"])
def test_several_pages_where_one_image_is_wanted(tmp_path, one_line, name):
    for frame in ("white", "dark", "background", "f1", "f2"):
        save(tmp_path / f"{frame}.tif", counts(3 if frame == name else 1))
    (tmp_path / "optics.json").write_text(json.dumps(SHEET))
    assert f"{name}.tif: holds 3 images, wanted one" in one_line("init", tmp_path, tmp_path / "optics.json")


def test_files_of_other_formats_are_left_alone(drafted, tmp_path):
    at = tmp_path / "run7"
    at.mkdir()
    (at / "results.h5").write_text("no HDF5 at all")
    np.save(at / "truth_static_a.npy", np.zeros(3))
    (at / ".hidden.tif").write_text("nor a TIFF")
    (at / "folder.tif").mkdir()
    experiment, lines = drafted(["f1.tif", "f2.tif"], others=["white.tif", "sketch.png"])
    assert experiment.recording_table.frames == ("f1.tif", "f2.tif")
    assert experiment.recording_table.background == "none"
    for name in ("results.h5", "truth_static_a.npy", "sketch.png"):
        assert name in line(lines, "not used")
    assert not any("hidden" in text or "folder.tif" in text for text in lines)


@pytest.mark.parametrize("names", [[f"f{k}.tif" for k in range(4)], ["B1_A.tif", "B1_B.tif", "B2_A.tif", "B2_B.tif"]])
def test_a_frame_that_cannot_be_read_is_drafted_all_the_same(tmp_path, capsys, one_line, names):
    """A run sets its pairs aside. Where half of them are so nothing is drafted."""
    for name in names:
        save(tmp_path / name, counts())
    save(tmp_path / "white.tif", counts())
    (tmp_path / "optics.json").write_text(json.dumps(SHEET))
    whole = (tmp_path / names[0]).read_bytes()
    (tmp_path / names[0]).write_bytes(whole[: len(whole) // 2])
    assert main(["init", str(tmp_path), str(tmp_path / "optics.json")]) == 0
    said = line(capsys.readouterr().out.splitlines(), "look at")
    assert f"{names[0]}: is truncated" in said
    assert "a run sets aside what it belongs to" in said
    recording = Experiment.load(tmp_path / "experiment.toml").recording()
    assert len(recording) == 4
    assert list(recording.damaged) == [0]
    (tmp_path / names[1]).write_bytes(b"")
    (tmp_path / "experiment.toml").unlink()
    assert f"{names[0]}: is truncated" in one_line("init", tmp_path, tmp_path / "optics.json")


@pytest.mark.parametrize(
    ("names", "images", "rows", "expected"),
    [
        (["B1_A.tif", "B1_B.tif", "B2_A.tif"], 1, ROWS, "B2_A.tif: is one frame of a pair by its name"),
        (["B1_A.tif", "B1_B.tif", "B2_A.tif", "B3_A.tif"], 1, ROWS, "the other is missing (so are 1 more)"),
        (["B1_A.tif", "B1_B.tif", "B2_A.tif", "B2_B.tif"], 2, ROWS, "hold 2 images each"),
        (["flat_1.tif", "flat_2.tif"], 1, ROWS, "found flat_1.tif, flat_2.tif, white.tif: keep one, and rename"),
        (["f1.tif"], 1, ROWS, "holds 1 frame beside white.tif"),
        (["dark.tif"], 1, ROWS, "holds 0 frames beside white.tif"),
        (["f1.tif", "f2.tif"], 1, ROWS - 2, "f1.tif: is 280 x 222 pixels, but white.tif is 280 x 224"),
    ],
)
def test_what_cannot_be_told_is_refused_in_one_line(tmp_path, one_line, names, images, rows, expected):
    for name in names:
        save(tmp_path / name, counts(images, rows))
    save(tmp_path / "white.tif", counts())
    (tmp_path / "optics.json").write_text(json.dumps(SHEET))
    assert expected in one_line("init", tmp_path, tmp_path / "optics.json")
    assert not (tmp_path / "experiment.toml").exists()


@pytest.mark.parametrize("name", ["two  spaces", "l'écoulement", '流れ $HOME `x` "3"', "-run #7", "Strömung 7"])
def test_printed_commands_can_be_pasted(drafted, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    experiment, lines = drafted(["f1.tif", "f2.tif"], folder=f"{name}/run 7")
    commands = [shlex.split(text, comments=True) for text in lines if text.startswith("  plenopiv ")]
    assert [words[:2] for words in commands] == [["plenopiv", step] for step in ("info", "check", "run")]
    for words in commands:
        assert len(words) == 3
        assert Path(words[2]) == experiment.path
    assert main(commands[0][1:]) == 0


def test_a_relative_folder_that_begins_with_a_dash(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "-x y"
    folder.mkdir()
    for name in ("white.tif", "f1.tif", "f2.tif"):
        save(folder / name, counts())
    (tmp_path / "optics.json").write_text(json.dumps(SHEET))
    assert main(["init", "--", "-x y", "optics.json"]) == 0
    printed = next(text for text in capsys.readouterr().out.splitlines() if text.startswith("  plenopiv info"))
    words = shlex.split(printed, comments=True)
    assert words == ["plenopiv", "info", "./-x y/experiment.toml"]
    assert main(words[1:]) == 0


@pytest.mark.parametrize("end", ["\u2028", "\u2029"])
def test_names_that_hold_line_ends_of_other_kinds(drafted, end):
    experiment, _ = drafted([f"x{end}_1.tif", f"x{end}_2.tif"])
    assert len(experiment.recording().frames) == 2
