"""Pairs that are read as a sequence: told by names, times and displacements. Frames that are one image."""

import shutil
import time

import numpy as np
import pytest
import tifffile
from recordings import VELOCITY_M_S, camera, copied, looked_at, record, wrong

from plenopiv.checks import repeats, reversal
from plenopiv.checks.reversal import Step, finding
from plenopiv.experiment import Experiment
from plenopiv.recording.naming import looks_like_pairs
from plenopiv.sensor import Sensor

MARGIN_MM = (0.25, 0.2, 0.3)
OTHERS = {"A": ("1", "a"), "B": ("1", "b"), "C": ("4", "a"), "D": ("4", "b"), "0": ("3", "a"), "3": ("3", "b")}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Frames at even times, 0 A B 3, of one flow; and C D of another instant."""
    base = tmp_path_factory.mktemp("simulated")
    for name, times, seed in (("1", 1, 3), ("3", 3, 3), ("4", 1, 4)):
        velocity = tuple(times * np.array(VELOCITY_M_S))
        record(base / name, velocity_m_s=velocity, margin_mm=MARGIN_MM, seed=seed)
    return base


@pytest.fixture
def film(simulated, tmp_path):
    """The folder of a sequence of these frames, each with noise of its own."""

    def made(frames, names="f{}.tif", noise=1.0):
        rng = np.random.default_rng(1)
        shutil.copy(simulated / "1" / "white.tif", tmp_path)
        for k, frame in enumerate(frames):
            folder, name = OTHERS[frame]
            counts = tifffile.imread(simulated / folder / f"{name}.tif")
            noisy = np.rint(counts + rng.normal(0, noise, counts.shape)).clip(0, 4095)
            tifffile.imwrite(tmp_path / names.format(k), noisy.astype(np.uint16))
        text = (simulated / "1" / "experiment.toml").read_text()
        pattern = names.replace("{}", "*")
        (tmp_path / "experiment.toml").write_text(text.replace('frames = ["a.tif", "b.tif"]', f'frames = "{pattern}"'))
        return tmp_path

    return made


def of_frames(folder):
    experiment = Experiment.load(folder / "experiment.toml")
    return reversal.of_frames(experiment.recording(), camera(), experiment.volume.z_mm)


@pytest.mark.parametrize(
    ("frames", "severity", "words"),
    [
        ("0AB3", "good", "successive displacements agree over 4 frames"),
        pytest.param("3BA0", "good", "successive displacements agree over 4 frames", marks=pytest.mark.full),
        ("ABAB", "unusable", "displacements of successive frames alternate"),
        pytest.param("ABA", "warning", "successive displacements are opposite", marks=pytest.mark.full),
        pytest.param("ABCD", "unusable", "only every second frame has particles in common", marks=pytest.mark.full),
        ("BCDAB", "unusable", "only every second frame has particles in common"),
    ],
)
def test_pairs_that_are_read_as_a_sequence_are_seen(film, frames, severity, words):
    found = of_frames(film(frames))
    assert (found.name, found.severity) == ("reversing", severity)
    assert found.words.startswith(words)
    assert ("instead of frames in [recording]" in found.advice) == (severity != "good")


def test_two_frames_and_pairs_are_not_asked(recorded, film):
    assert of_frames(recorded()) is None
    folder = film("ABCD", names="f_{}.tif")
    for k in range(4):
        (folder / f"f_{k}.tif").rename(folder / f"f{k // 2}_{'ab'[k % 2]}.tif")
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace('frames = "f_*.tif"', 'pairs = "f*_{a,b}.tif"'))
    assert of_frames(folder) is None


def step(displacement, correlation=0.5, windows=6, seed=0):
    rng = np.random.default_rng(seed)
    return Step(np.array(displacement) + rng.normal(0, 0.03, (windows, 3)), np.full(windows, correlation))


FORTH, BACK, LONGER, STILL = (0.7, -0.4, 0.2), (-0.7, 0.4, -0.2), (2.1, -1.2, 0.6), (0.02, 0.0, -0.03)


@pytest.mark.parametrize(
    ("steps", "severity"),
    [
        ([FORTH, FORTH], "good"),
        ([FORTH, BACK], "warning"),
        ([FORTH, BACK, FORTH], "unusable"),
        ([FORTH, LONGER, FORTH, LONGER], "unusable"),  # pairs from a light that follows soon, particles still in sight
        ([STILL, STILL, STILL], "good"),
        ([FORTH, FORTH, LONGER], None),
        ([FORTH, BACK, BACK], None),  # a flow may reverse once
        ([FORTH], None),
    ],
)
def test_what_successive_displacements_say(steps, severity):
    found = finding([step(moved, seed=k) for k, moved in enumerate(steps)])
    assert (found and found.severity) == severity


@pytest.mark.parametrize(
    ("correlations", "severity"),
    [
        ((0.5, 0.12, 0.5), "unusable"),
        ((0.12, 0.5, 0.12), "warning"),
        ((0.12, 0.5, 0.12, 0.5), "unusable"),
        ((0.5, 0.12, 0.12), None),
        ((0.1, 0.12, 0.1), None),
        ((0.25, 0.2, 0.25), None),
        ((0.41, 0.24, 0.42, 0.23), "unusable"),  # a sensor so small that chance correlates more
        ((0.41, 0.32, 0.42, 0.30), "good"),
        ((0.41, 0.24, 0.24, 0.42), "good"),
        ((0.5, 0.12), None),
    ],
)
def test_what_correlations_of_successive_frames_say(correlations, severity):
    found = finding([step(FORTH, c) for c in correlations])
    assert (found and found.severity) == severity


def test_the_advice_names_the_pattern():
    named = looks_like_pairs(["B1_A.tif", "B1_B.tif", "B2_A.tif", "B2_B.tif"])
    found = finding([step(FORTH), step(BACK), step(FORTH)], named.pattern)
    assert found.advice.startswith('write pairs = "B*_{A,B}.tif" (names without their folder) instead of frames')


@pytest.mark.usefixtures("still")
def test_names_of_pairs_make_a_sequence_unusable_unless_it_moves_evenly(film):
    folder = film("ABCD")
    for k in range(4):
        (folder / f"f{k}.tif").rename(folder / f"B0000{k // 2}_{'AB'[k % 2]}.tif")
    found = looked_at(folder, recording__frames="B*.tif")
    assert not found.usable
    faults = wrong(found)
    assert faults.keys() == {"pairs-as-sequence", "reversing"}
    assert "B00000_A.tif and B00000_B.tif" in faults["pairs-as-sequence"].words
    assert 'write pairs = "B*_{A,B}.tif"' in faults["pairs-as-sequence"].advice
    tables = Experiment.load(folder / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["recording"] = tables["recording"] | {"pairs": "B*_{A,B}.tif"}
    del tables["recording"]["frames"]
    as_pairs = Experiment.from_dict(tables, folder / "experiment.toml")
    assert reversal.of_names(as_pairs.recording()) is None


@pytest.mark.full
@pytest.mark.usefixtures("still")
def test_a_sequence_with_names_of_pairs_is_a_warning(film):
    folder = film("0AB3")
    for k in range(4):
        (folder / f"f{k}.tif").rename(folder / f"B0000{k // 2}_{'AB'[k % 2]}.tif")
    found = looked_at(folder, recording__frames="B*.tif")
    assert found.usable
    assert wrong(found).keys() == {"pairs-as-sequence"}


def one_image(folder):
    return repeats.findings(Experiment.load(folder / "experiment.toml").recording())


@pytest.mark.full
def test_a_frame_that_is_there_twice(recording):
    assert one_image(recording) == []
    shutil.copy(recording / "a.tif", recording / "b.tif")
    found = looked_at(recording)
    assert not found.usable
    assert "a.tif and b.tif are one image, down to its noise" in wrong(found)["same-frame"].words


def test_blank_frames_alike_are_no_copies_of_each_other(recording):
    """They cannot be used, each for itself; whatever else the recording holds can."""
    for name in "ab":
        tifffile.imwrite(recording / f"{name}.tif", np.full_like(tifffile.imread(recording / "a.tif"), 60))
    assert one_image(recording) == []


@pytest.mark.parametrize("gain", [0.5, 0.83, 2.0])
def test_a_frame_that_is_there_twice_on_another_scale(recording, gain):
    counts = tifffile.imread(recording / "a.tif")
    scaled = np.minimum(np.rint(60 + (counts - 60.0) * gain), 4095)
    tifffile.imwrite(recording / "b.tif", scaled.astype(np.uint16), compression="adobe_deflate")
    (found,) = one_image(recording)
    assert (found.name, found.severity) == ("same-frame", "unusable")


def test_particles_that_stand_still_are_two_images(tmp_path):
    """The same particles at the same places, exposed twice: only the noise differs."""
    record(tmp_path / "r", velocity_m_s=(0.0, 0.0, 0.0))
    assert one_image(tmp_path / "r") == []


def test_noise_tells_two_exposures_at_any_gain():
    rng = np.random.default_rng(0)
    sensor, light = Sensor(200, 200, 0.0055, 12, 0), rng.gamma(0.5, 400.0, (200, 200))
    for gain in (0.05, 0.25, 1.0):  # counts per electron
        a, b = (np.rint(gain * rng.poisson(light / gain)).clip(0, 4095).astype(np.uint16) for _ in "ab")
        assert not repeats.same_image(a, b, sensor)
        assert repeats.same_image(a, (a // 2).astype(np.uint16), sensor)


def test_one_pair_of_many_and_frames_of_two_pairs(film):
    folder = film("ABCDABCD", noise=2.0)
    shutil.copy(folder / "f2.tif", folder / "f3.tif")
    shutil.copy(folder / "f0.tif", folder / "f6.tif")
    tables = Experiment.load(folder / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    pairs = [[f"f{k}.tif", f"f{k + 1}.tif"] for k in range(0, 8, 2)]
    tables["recording"] = {k: v for k, v in tables["recording"].items() if k != "frames"} | {"pairs": pairs}
    recording = Experiment.from_dict(tables, folder / "experiment.toml").recording()
    within, others = repeats.findings(recording)
    assert (within.severity, others.severity) == ("warning", "warning")
    assert "f2.tif and f3.tif" in within.words
    assert "f0.tif and f6.tif" in others.words


def test_many_files_are_compared_in_no_time(recorded, tmp_path):
    folder = copied(recorded(), tmp_path / "r")
    for k in range(200):
        shutil.copy(folder / "a.tif", folder / f"x{k}.tif")
    recording = Experiment.load(folder / "experiment.toml").recording()
    again = type(recording)(
        recording.sensor,
        tuple(folder / f"x{k}.tif" for k in range(200)),
        recording.white_path,
        recording.dt_s,
        recording.orientation,
    )
    began = time.perf_counter()
    (found,) = repeats.findings(again)
    assert time.perf_counter() - began < 5.0
    assert found.severity == "unusable"
