"""What names of files say, and that nothing which names itself dark, background or white becomes a frame."""

import sys

import numpy as np
import pytest
import tifffile

from plenopiv.errors import PlenoPIVError
from plenopiv.recording import find_frames, natural_order
from plenopiv.recording.naming import are_pulses, glob_of, looks_like_pairs, role
from plenopiv.recording.pairs import pairs, sequence
from plenopiv.recording.sources import only_source

ROLES = {
    "white": ("white.tif", "White_0.tif", "WhiteImage.tif", "calib.tif", "flat_1.png", "run7_white.tif", "white_a.tif"),
    "dark": ("dark.tif", "Dark_01.tif", "run1_dark.png", "run1_dark_frameA.tif", "run1_dark_pulse1.tif"),
    "background": ("bg.tif", "background_a.tif", "bg_0001_LA.tif", "static_1.tif", "jet_background.tif", "x.h5::bg"),
    "target": ("target_00.tif",),
    "mask": ("mask.png",),
    None: ("a.tif", "B00001_A.tif", "frame9.tif", "whirl_1.tif", "0001.tif", "starlight.tif", "r.h5::frames"),
}


@pytest.mark.parametrize(("wanted", "name"), [(wanted, name) for wanted, names in ROLES.items() for name in names])
def test_roles_are_read_off_names(wanted, name):
    assert role(name) == wanted


PAIRS = {
    "B{k:05}_{p}.tif": ("AB", "B*_{A,B}.tif"),
    "img{k:03}{p}.tif": ("ab", "img*{a,b}.tif"),
    "run_{k:03}_{p}.tif": ("12", "run_*_{1,2}.tif"),
    "{k}_{p}.png": ("01", "*_{0,1}.png"),
    "x{k}La{p}.im7": ("01", "x*La{0,1}.im7"),
    "LaserPulse{p}_{k:04}.tif": ("01", "LaserPulse{0,1}_*.tif"),
    "run{k}frame{p}.tif": ("AB", "run*frame{A,B}.tif"),
    "exp{k:03}.T000.H000.L{p}.TIF": ("AB", "exp*.T000.H000.{LA,LB}.TIF"),
    "s{k}_{p}.tif": (("first", "second"), "s*_{first,second}.tif"),
    "{p}/{k:04}.tif": ("AB", "{A,B}/*.tif"),
    "Strömung {k} {p}.tif": ("ab", "Strömung * {a,b}.tif"),
    "run [{k}]_{p}.tif": ("ab", ""),
}


@pytest.mark.parametrize("form", PAIRS)
def test_names_of_double_frames_are_recognised(form):
    pulses, pattern = PAIRS[form]
    expected = [tuple(form.format(k=k, p=p) for p in pulses) for k in (1, 2, 11)]
    names = sorted((name for pair in expected for name in pair), key=natural_order)
    found = looks_like_pairs(names)
    assert found.pattern == pattern
    assert sorted(found.pairs) == sorted(expected)
    assert found.alone == ()
    missing = looks_like_pairs([name for name in names if name != expected[1][1]])
    assert missing.alone == (expected[1][0],)


@pytest.mark.parametrize("form", ["run_{k:04}_{p}.tif", "run_{k:04}_Laser{p}.tif"])
def test_one_whole_pair_says_that_the_others_are_halves(form):
    pulses = "01" if "Laser" in form else "AB"
    names = [form.format(k=k, p=pulses[p]) for k, p in ((1, 0), (1, 1), (2, 0), (3, 0), (4, 1))]
    found = looks_like_pairs(names)
    assert found.pairs == (tuple(names[:2]),)
    assert found.alone == tuple(names[2:])


def test_pulses_of_most_names_come_before_letters_of_a_few():
    names = ["a_1_La0.tif", "a_1_La1.tif", "a_2_La0.tif", "a_2_La1.tif", "b_1_La0.tif"]
    found = looks_like_pairs(names)
    assert found.pairs == (tuple(names[:2]), tuple(names[2:4]))
    assert found.alone == ("b_1_La0.tif",)


@pytest.mark.parametrize(
    "names",
    [
        ("run_1_1.tif", "run_1_2.tif", "run_2_1.tif", "run_3_1.tif"),
        ("frame_1.tif", "frame_2.tif", "frame_3.tif"),
        ("frame_1.tif", "frame_2.tif"),
        ("a.tif", "b.tif"),
        ("a.tif", "b.tif", "c.tif"),
        ("img_01.tif", "img_02.tif", "img_11.tif", "img_12.tif"),
        ("run_1_1.tif", "run_1_2.tif", "run_1_3.tif", "run_2_1.tif", "run_2_2.tif", "run_2_3.tif"),
        ("frame0.tif", "frame1.tif", "frame2.tif", "frame3.tif"),
        ("x_a.tif", "y_b.tif", "z_a.tif"),
    ],
)
def test_names_that_may_be_a_sequence_are_no_pairs(names):
    assert looks_like_pairs(names) is None


def test_pulses_of_two_names():
    assert are_pulses("background_a.tif", "background_b.tif")
    assert are_pulses("bg_1.tif", "bg_2.tif")
    assert not are_pulses("background_b.tif", "background_a.tif")
    assert not are_pulses("bg_1.tif", "bg_3.tif")
    assert not are_pulses("bg_1_a.tif", "bg_2_b.tif")


def test_patterns_of_names():
    assert glob_of(["run_1.tif", "run_20.tif"]) == "run_*.tif"
    assert glob_of(["run_1_x.tif", "run_20_x.tif"]) == "run_*_x.tif"
    assert glob_of(["film.tif"]) == "film.tif"
    assert glob_of(["a1.h5::frames", "a2.h5::frames"]) == "a*.h5::frames"
    assert glob_of(["a[1].tif", "a[2].tif"]) == ""


@pytest.fixture
def folder(tmp_path):
    def made(*names):
        for k, name in enumerate(names):
            tifffile.imwrite(tmp_path / name, np.arange(2400, dtype=np.uint16).reshape(40, 60) + k)
        return tmp_path

    return made


@pytest.mark.parametrize(
    ("name", "way_out"),
    [
        ("dark.tif", "name it in recording.dark"),
        ("background_a.tif", "name it in recording.background"),
        ("flat.tif", "name it in recording.white"),
        ("target_00.tif", "an image of a calibration target"),
    ],
)
def test_no_pattern_takes_other_images_for_frames_in_silence(folder, name, way_out):
    at = folder("f1.tif", "f2.tif", name)
    with pytest.raises(PlenoPIVError, match=way_out) as caught:
        sequence(at, "*.tif")
    assert str(caught.value).startswith(f"{at / name}: the pattern '*.tif' takes it for a frame")
    assert len(sequence(at, "*.tif", [at / name])) == 2
    assert len(sequence(at, ["f1.tif", "f2.tif", name])) == 3  # a list says what it wants


def test_a_pattern_that_spells_the_name_out_takes_it(folder):
    at = folder("flat_plate_1.tif", "flat_plate_2.tif", "dark.tif")
    assert [p.name for p in find_frames(at, "flat_plate_*.tif")] == ["flat_plate_1.tif", "flat_plate_2.tif"]
    with pytest.raises(PlenoPIVError, match=r"white image.*\(1 more like it\)"):
        find_frames(at, "*.tif", [at / "dark.tif"])


def test_pairs_take_no_background(folder):
    at = folder("r1_a.tif", "r1_b.tif", "background_a.tif", "background_b.tif")
    with pytest.raises(PlenoPIVError, match=r"background_a\.tif: the pattern"):
        pairs(at, "*_{a,b}.tif")
    found, _ = pairs(at, "*_{a,b}.tif", None, [at / "background_a.tif", at / "background_b.tif"])
    assert [frame.path.name for frame in found] == ["r1_a.tif", "r1_b.tif"]


def test_a_pattern_of_folders_takes_none_of_dark_images(folder):
    at = folder("notes.tif")
    for name in ("run1", "run2", "dark"):
        (at / name).mkdir()
        tifffile.imwrite(at / name / "1.tif", np.arange(2400, dtype=np.uint16).reshape(40, 60))
    with pytest.raises(PlenoPIVError, match=r"dark/1\.tif: the pattern '\*/\*\.tif' takes it for a frame"):
        find_frames(at, "*/*.tif")
    assert len(find_frames(at, "run*/*.tif")) == 2
    assert len(find_frames(at, "dark/*.tif")) == 1


@pytest.mark.parametrize("pattern", [".", "./", "/"])
def test_a_pattern_that_is_a_folder_is_none(folder, pattern):
    at = folder("f1.tif", "f2.tif")
    for read in (sequence, pairs):
        with pytest.raises(PlenoPIVError, match=r"is no file pattern \(it names a folder\); add one, as in \*\.tif"):
            read(at, pattern)


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
def test_a_link_to_itself_is_told_of_when_it_is_read(folder):
    at = folder("f1.tif", "f2.tif")
    (at / "white.tif").symlink_to(at / "white.tif")
    assert len(find_frames(at, "f*.tif", [at / "white.tif"])) == 2
    with pytest.raises(PlenoPIVError, match=r"white\.tif: cannot be read"):
        only_source(at / "white.tif")
