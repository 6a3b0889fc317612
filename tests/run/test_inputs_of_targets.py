"""What a calibration with a target is made of, and when it is made again."""

import tomllib
import warnings
from dataclasses import replace

import h5py
import numpy as np
import pytest
import tifffile
import tomli_w
from calibrations import calibrated

from plenopiv.cameras.space_map import ViewShift
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.calibration_file import load_calibration, save_calibration
from plenopiv.run import target
from plenopiv.run.calibrated import calibrated_camera
from plenopiv.run.inputs import calibrating_files, exactly

COLUMNS, ROWS = 120, 96
IMAGES = "near/target.tif", "far/target.tif", "middle.tif"
TABLES = {
    "camera": {
        "kind": "plenoptic",
        "main_lens": {"focal_length_mm": 50.0, "aperture_mm": 25.0, "magnification": -1.0},
        "microlens_array": {"lattice": "hexagonal", "pitch_mm": 0.077, "focal_length_mm": 0.308},
        "sensor": {"columns": COLUMNS, "rows": ROWS, "pixel_pitch_mm": 0.0055, "bit_depth": 12},
    },
    "calibration": {
        "target": "dots", "pitch_mm": 0.6, "dot_mm": 0.2, "origin_dot_mm": 0.36,
        "planes": [{"image": image, "z_mm": float(k)} for k, image in enumerate(IMAGES)],
    },
    "recording": {
        "white": "white.tif", "dark": "dark.tif", "mask": "mask.tif", "frames": ["a.tif", "b.tif"], "dt_s": 1e-3,
        "orientation": "upright",
    },
    "volume": {
        "x_mm": [-0.4, 0.4], "y_mm": [-0.3, 0.3], "z_mm": [-1.0, 1.0], "voxel_mm": [0.02, 0.02, 0.1], "unseen": "empty",
    },
    "correlation": {"windows": [[16, 16, 16]]},
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    for k, name in enumerate((*IMAGES, "white.tif", "dark.tif", "mask.tif", "a.tif", "b.tif")):
        write(tmp_path / name, k)
    (tmp_path / "experiment.toml").write_text(tomli_w.dumps(TABLES))
    return tmp_path


def write(path, seed):
    path.parent.mkdir(parents=True, exist_ok=True)
    tifffile.imwrite(path, np.random.default_rng(seed).integers(0, 9, (ROWS, COLUMNS)).astype(np.uint16))


def opened(folder, **calibration):
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["calibration"] |= calibration
    experiment = Experiment.from_dict(tables, folder / "experiment.toml")
    return experiment, experiment.recording()


@pytest.fixture
def made(monkeypatch):
    """How often a calibration was made; none is computed."""
    times = []
    monkeypatch.setattr(target, "make_calibration", lambda *given: times.append(1) or calibrated())
    return times


@pytest.mark.parametrize("name", [*IMAGES, "white.tif", "dark.tif", "mask.tif"])
def test_a_changed_image_is_noticed(folder, name):
    before = target.inputs_of(*opened(folder)), calibrating_files(*opened(folder))
    write(folder / name, 99)
    now = target.inputs_of(*opened(folder)), calibrating_files(*opened(folder))
    assert [len(was.items() ^ found.items()) for was, found in zip(before, now, strict=True)] == [2, 2]
    write(folder / "a.tif", 99)
    assert target.inputs_of(*opened(folder)) == now[0]


NUMBERED = {  # by a camera, in each folder from 1
    "white": "white/1.tif", "dark": "dark/1.tif", "mask": "mask/1.tif", "background": ["glow/a/1.tif", "glow/b/1.tif"],
    "frames": ["flow/1.tif", "flow/2.tif"],
}  # fmt: skip


@pytest.mark.parametrize(
    "name", ["white/1.tif", "dark/1.tif", "mask/1.tif", "glow/a/1.tif", "glow/b/1.tif", "dots/1.tif"]
)
def test_a_changed_image_is_noticed_where_others_have_its_name(folder, name):
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["recording"] |= NUMBERED
    tables["calibration"]["planes"] = [{"image": f"dots/{k}.tif", "z_mm": float(k)} for k in (1, 2)]
    named = ("white/1", "dark/1", "mask/1", "glow/a/1", "glow/b/1", "dots/1", "dots/2", "flow/1", "flow/2")
    for k, image in enumerate(named):
        write(folder / f"{image}.tif", k)
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    before = target.inputs_of(*opened(folder)), calibrating_files(*opened(folder))
    write(folder / name, 99)
    now = target.inputs_of(*opened(folder)), calibrating_files(*opened(folder))
    of_camera = not name.startswith("glow")  # static light has no part in a calibration
    changed = [len(was.items() ^ found.items()) for was, found in zip(before, now, strict=True)]
    assert changed == [2 * of_camera, 2]


def test_its_own_name_is_enough_for_a_file_where_no_other_has_it(folder):
    """As in results and calibrations of before, which stay valid; one file may serve twice."""
    whole = {"white.tif", "dark.tif", "mask.tif", "target.tif (1)", "target.tif (2)", "middle.tif"}
    experiment, recording = opened(folder)
    assert calibrating_files(experiment, recording).keys() == whole
    assert whole - {"mask.tif"} < target.inputs_of(experiment, recording).keys()
    twice = replace(recording, background_paths=(folder / "dark.tif",))
    assert calibrating_files(experiment, twice).keys() == whole
    write(folder / "glow" / "dark.tif", 98)
    other = replace(recording, background_paths=(folder / "glow" / "dark.tif",))
    apart = {"dark.tif (dark)", "dark.tif (background 1)"}
    assert calibrating_files(experiment, other).keys() == whole - {"dark.tif"} | apart


def test_a_changed_data_set_is_noticed_and_frames_beside_it_are_not(folder):
    images = np.random.default_rng(0).integers(0, 9, (4, ROWS, COLUMNS)).astype(np.uint16)
    with h5py.File(folder / "all.h5", "w") as file:
        file["white"], file["camera/dark"] = images[:2]
        file.create_dataset("frames", data=images[2:], maxshape=(None, ROWS, COLUMNS))
    named = {"white": "all.h5::white", "dark": "all.h5::camera/dark", "frames": "all.h5::frames"}
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["recording"] |= named
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    before = calibrating_files(*opened(folder))
    assert None not in before.values()
    with h5py.File(folder / "all.h5", "a") as file:
        file["frames"].resize(3, axis=0)
        file["frames"][2] = images[0]
    assert calibrating_files(*opened(folder)) == before
    with h5py.File(folder / "all.h5", "a") as file:
        file["white"][0, 0] += 1
    now = calibrating_files(*opened(folder))
    assert {name for name in now if now[name] != before[name]} == {"all.h5::white"}


@pytest.mark.parametrize("changed", [{"pitch_mm": 0.61}, {"step_mm": 0.5}, {"x_dot_mm": 0.3}])
def test_a_changed_key_is_noticed(folder, changed):
    assert target.inputs_of(*opened(folder, **changed)) != target.inputs_of(*opened(folder))


def test_where_the_laboratory_s_origin_is_put_needs_no_new_fit(folder):
    moved = opened(folder, origin_mm=[1.0, 2.0, 3.0], turn_deg=90.0)
    assert target.inputs_of(*moved) == target.inputs_of(*opened(folder))


def test_it_is_made_once_and_again_of_other_inputs(folder, made):
    file = folder / "calibration.toml"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(2):
            assert exactly(target.target_calibration(*opened(folder))) == exactly(calibrated())
    assert len(made) == 1
    write(folder / "middle.tif", 99)
    with pytest.warns(PlenoPIVWarning, match=r"calibration.toml: was made of other inputs \(middle.tif\); it is made"):
        target.target_calibration(*opened(folder))
    assert len(made) == 2
    assert load_calibration(file)[1] == target.inputs_of(*opened(folder))


def test_what_a_summary_says_of_it(folder, made):
    """Residuals of all dots; a plane of which none is seen whole has none."""
    camera, said = calibrated_camera(*opened(folder))
    assert exactly(camera) == exactly(calibrated().camera)
    assert said["target_dots"] == 207
    assert said["target_residual_um"] == pytest.approx([0.31, 0.42, 3.3])
    assert said["pitch_mm"] == 0.0771


def test_a_damaged_one_is_refused_and_stays(folder, made):
    (folder / "calibration.toml").write_text("[inputs]\n")
    with pytest.raises(PlenoPIVError, match=r"calibration.toml: is damaged: .*: make it anew with: plenopiv calibrate"):
        target.target_calibration(*opened(folder))
    assert not made
    assert (folder / "calibration.toml").read_text() == "[inputs]\n"


def found_by_results(folder, experiment, made):
    """The experiment as a results folder states it, which finds the calibration and writes none of its own."""
    results = folder / "results"
    results.mkdir()
    (results / "experiment.toml").write_text(experiment.dump_toml(results))
    again = Experiment.load(results / "experiment.toml")
    assert exactly(target.target_calibration(again, again.recording())) == exactly(calibrated())
    assert len(made) == 1
    assert [path.name for path in results.iterdir()] == ["experiment.toml"]
    return again


def test_a_results_folder_finds_the_one_beside_the_experiment(folder, made):
    """Where the target's images are in a folder of their own."""
    experiment, recording = opened(folder)
    target.target_calibration(experiment, recording)
    found_by_results(folder, experiment, made)


def test_a_results_folder_finds_the_one_beside_the_images(folder, made):
    for name in IMAGES:
        (folder / name).rename(folder / name.replace("/", "_"))
    planes = [{"image": name.replace("/", "_"), "z_mm": float(k)} for k, name in enumerate(IMAGES)]
    experiment, recording = opened(folder, planes=planes)
    target.target_calibration(experiment, recording)
    again = found_by_results(folder, experiment, made)
    write(folder / "middle.tif", 99)
    target.target_calibration(again, again.recording())
    assert len(made) == 2


@pytest.mark.parametrize("beside", [None, ViewShift(12.5, 1.2, 1, ((1e-3, 0.0),) * 5)])
def test_a_self_calibration_that_is_lost_is_told_of(folder, made, beside):
    """With what it was added to, where another camera makes that anew."""
    experiment, recording = opened(folder)
    inputs = target.inputs_of(experiment, recording) | {"[camera]": "another"}
    save_calibration(replace(calibrated(), beside=beside), inputs, folder / "calibration.toml")
    with pytest.warns(PlenoPIVWarning, match=r"was made of other inputs \(\[camera\]\); it is made again") as told:
        target.target_calibration(experiment, recording)
    assert made == [1]
    lost = "what plenopiv selfcalibrate added is lost: give it again"
    assert [str(w.message).endswith(lost) for w in told] == [beside is not None]
