"""Which pair, which time, whose axes: what stands beside the numbers of a page."""

import numpy as np
import pytest
from pages import Parsed, example, field, without_figures, write

from plenopiv.recording.recording import NUMBERED
from plenopiv.report import charts, figures
from plenopiv.report.document import place_mm
from plenopiv.report.field import field_data
from plenopiv.report.moments import moments, series_in
from plenopiv.report.stacks import joined
from plenopiv.report.viewers import scene, slices

SERIES = {"time_s": [0.5, 1.5, 2.5], "replaced_share": [0.1] * 3, "median_peak_ratio": [2.0] * 3}
SERIES |= {"largest_velocity_m_s": [1.0] * 3}


def numbered(dataset):
    dataset["time"].attrs["long_name"] = f"{NUMBERED}; the time between pairs is not known"
    return dataset


def three(dataset):
    import xarray

    return xarray.concat([dataset.assign_coords(time=[t]) for t in SERIES["time_s"]], "time")


def test_a_page_names_the_pair_that_it_shows(tmp_path, monkeypatch):
    """The first was set aside."""
    without_figures(monkeypatch)
    given = {"series": SERIES, "fields": series_in(three(field())), "number": 1}
    said = Parsed(write(tmp_path / "report.html", example(), field(), **given)).text
    for words in ("middle, of pair 2", "replaced, of pair 2", "Uncertainty, of pair 2", "vectors, of pair 2 of 3;"):
        assert words in said.replace("Through the ", ""), words
    assert "of the first" not in said
    assert "counted from 1 here, from 0 in summary.json" in said


def test_times_that_only_number_pairs_are_not_shown_as_seconds(tmp_path, monkeypatch):
    whole = numbered(three(field()))
    assert [m.label for m in moments(series_in(whole), (1, 1, 1), 3)][:2] == ["pair 1 of 3", "pair 2 of 3"]
    of_time = charts.series_figure(SERIES).axes[0]
    of_pair = charts.series_figure(SERIES, numbered=True).axes[0]
    assert (of_time.get_xlabel(), of_pair.get_xlabel()) == ("time (s)", "pair")
    assert list(of_pair.lines[0].get_xdata()) == [1, 2, 3]
    without_figures(monkeypatch)
    one = numbered(field())
    said = Parsed(write(tmp_path / "report.html", example(), one, series=SERIES, fields=series_in(whole))).text
    assert "Each pair by its number." in said


def test_the_share_of_vectors_replaced_is_of_those_outside_a_body():
    """Half of the planes' vectors lie in a body; of one plane all others were replaced."""
    dataset = field()
    dataset["valid"][:] = 1
    for name in "uvw":
        dataset[name][..., :3] = np.nan
    dataset["valid"][..., :3] = 0
    dataset["valid"][:, 2] = 0
    front, above, depth, *_ = charts.validation_figure(dataset).axes
    assert depth.lines[0].get_ydata() == pytest.approx([0, 0, 100, 0])
    seen = np.ma.filled(front.images[0].get_array(), np.nan)
    assert np.isnan(seen[:, :3]).all()
    assert seen[:, 3:] == pytest.approx(np.full((5, 3), 25.0))
    assert np.ma.filled(above.images[0].get_array(), np.nan)[:, 4] == pytest.approx([0, 0, 100, 0])


def test_vectors_in_a_body_are_not_counted_as_measured(tmp_path, monkeypatch):
    without_figures(monkeypatch)
    for inside, words in ((None, "measured, not replaced90"), (12, "measured, not replaced, outside the body90")):
        summary = {} if inside is None else {"vectors_inside_body": inside}
        assert words in Parsed(write(tmp_path / "report.html", example(), field(), summary=summary)).text


@pytest.mark.parametrize("frame", ["camera", "laboratory"])
def test_axes_of_the_laboratory_are_not_what_the_camera_sees(frame):
    dataset = field()
    dataset.attrs["frame"] = frame
    data = field_data(dataset)
    assert ("camera sees" in scene(data), "camera sees" in slices(data)) == (frame == "camera",) * 2
    label = charts.accuracy_figure(Profile, dataset).axes[0].get_xlabel()
    assert label == ("z (mm), toward the camera" if frame == "camera" else "z (mm)")


class Profile:
    """Of two planes."""

    z_mm, rms, bias = np.array([0.0, 1.0]), np.ones((3, 2)), np.zeros((3, 2))


@pytest.mark.parametrize(
    ("value", "apart", "said"),
    [(4.2, 0.25, "4.20"), (0.0042, 0.0011, "0.0042"), (1.0, 20.0, "1.00"), (2.0, 0.0, "2.00")],
)
def test_places_are_told_from_their_neighbours(value, apart, said):
    assert place_mm(value, np.array([0.0, apart])) == said
    assert place_mm(value, np.array([0.0])) == f"{value:.2f}"
    dataset = field().assign_coords(z=apart * np.arange(4.0)) if apart else field()
    at = place_mm(2 * apart, dataset.z.values) if apart else "0.00"
    assert figures.velocity_figure(dataset).axes[0].get_title("left") == f"xy at z = {at} mm"


@pytest.mark.parametrize("count", [420, 421, 839, 841, 1300])
def test_joined_pixels_stay_where_they_are(count):
    """To a pixel of the whole picture beside the joined ones' half."""
    for at in (0, 5, count // 2, count - 3, count - 1):
        image = np.zeros((3, count))
        image[:, at] = 1.0
        found = joined(image, 420)
        assert found.shape[1] <= 420
        place = (np.argmax(found[0]) + 0.5) / found.shape[1] * count
        assert abs(place - (at + 0.5)) <= 0.5 * count / found.shape[1] + 0.5
    assert np.isnan(joined(np.full((900, 2), np.nan), 420)).all()
    assert (joined(np.where(np.arange(900)[:, None] % 2, np.nan, 1.0), 450) == 1.0).all()  # dark, not unseen
