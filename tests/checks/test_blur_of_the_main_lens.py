"""What a check says of a main lens that is not sharp."""

from dataclasses import replace

import pytest
from recordings import camera, looked_at, record, wrong

from plenopiv.checks import check
from plenopiv.checks.lens_blur import finding
from plenopiv.experiment import Experiment
from plenopiv.reconstruction.lens_blur import LensBlur
from plenopiv.sensor import Sensor

NAME = "main-lens-blur"


@pytest.fixture(scope="module")
def blurred(tmp_path_factory):
    """A recording of 0.03 mm, which its file does not state."""
    of = replace(camera(), sensor=Sensor(504, 476, 0.0055, 12, 60), blur_mm=0.03)
    folder = record(tmp_path_factory.mktemp("blurred") / "r", of=of)
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace("blur_mm = 0.03\n", ""))
    return folder


@pytest.mark.usefixtures("still")
def test_blur_is_named_with_its_size_and_not_as_a_crowd(blurred):
    found = wrong(looked_at(blurred))
    assert found.keys() == {NAME}
    assert found[NAME].number == pytest.approx(30.0, rel=0.2)
    assert found[NAME].unit == "um"
    assert "the main lens blurs" in found[NAME].words
    assert "set camera.main_lens.blur_mm = 0.0" in found[NAME].advice


@pytest.mark.full
@pytest.mark.usefixtures("still")
def test_a_blur_that_is_stated_is_good(blurred):
    assert NAME not in wrong(looked_at(blurred, camera__main_lens__blur_mm=0.03))


@pytest.mark.full
def test_none_is_found_where_there_is_none(recorded):
    (found,) = [each for each in looked_at(recorded()).findings if each.name == NAME]
    assert found.severity == "good"
    assert "is sharp" in found.words


@pytest.mark.usefixtures("still")
def test_behind_a_window_it_is_not_looked_for(blurred):
    air = Experiment.load(blurred / "experiment.toml")
    given = air.recording(), air.camera(), air.grid(), air.correlation.settings()
    assert NAME not in [each.name for each in check(*given, blur_measured=None).findings]


@pytest.mark.parametrize(
    ("blur_mm", "stated_mm", "measured", "severity", "words"),
    [
        (0.02, 0.0, False, "warning", "standard deviation of 20 um at the microlenses, 0.26 pitches"),
        (0.02, 0.0, True, "good", "which a run takes into account"),
        (0.02, 0.022, False, "good", "which a run takes into account"),
        (0.02, 0.04, False, "warning", "not the stated 40 um"),
        (0.008, 0.0, False, "good", "is sharp"),
        (0.008, 0.008, False, "good", "is sharp"),
        (0.008, 0.0, True, "good", "is sharp"),
        (0.001, 0.03, False, "warning", "is sharp in a.tif; camera.main_lens.blur_mm = 0.03 states a blur"),
    ],
)
def test_what_is_said_of_a_blur(blur_mm, stated_mm, measured, severity, words):
    said = finding(LensBlur(blur_mm, 0.001, 0.1), stated_mm, 0.077, "a.tif", measured)
    assert said.severity == severity
    assert words in said.words
    assert bool(said.advice) == (severity == "warning")
