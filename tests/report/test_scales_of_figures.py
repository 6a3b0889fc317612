"""Figures of commands: one outlier leaves the others readable, texts do not lie over one another, panels are cut."""

import io
from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from pages import example, field
from PIL import Image

from plenopiv.checks import CheckResult
from plenopiv.checks.motion import Motion
from plenopiv.report.check import check_figure
from plenopiv.report.figures import Drawn, histogram_figure, png, velocity_figure
from plenopiv.report.light_field import contact_sheet


def moved(lengths):
    """The panel of displacements of ``check.png``: their arrows in the figure, and its words."""
    rng = np.random.default_rng(0)
    place = np.column_stack([rng.uniform(-1, 1, (len(lengths), 2)), np.zeros(len(lengths))])
    move = np.column_stack([lengths, np.zeros(len(lengths)), rng.normal(0, 0.01, len(lengths))])
    image = np.zeros((224, 280), np.uint16)
    found = CheckResult((), example().camera(), "a.tif", image, image, motion=Motion(place, move, 0.9))
    figure = check_figure(found)
    (axes,) = [axes for axes in figure.axes if axes.get_title(loc="left") == "estimated displacement"]
    (arrows,) = [artist for artist in axes.collections if isinstance(artist, Quiver)]
    span = np.ptp(axes.get_xlim())
    return arrows.U / arrows.scale / span, " ".join(text.get_text() for text in axes.texts)


def test_one_outlier_leaves_the_other_displacements_readable():
    usual, words = moved(np.full(40, 0.1))
    assert "shortened" not in words
    with_outlier, words = moved(np.append(np.full(39, 0.1), 5.0))
    np.testing.assert_allclose(with_outlier[:39], usual[:39], rtol=1e-6)
    assert with_outlier[39] == pytest.approx(2 * usual[0])
    assert "1 longer, drawn shortened" in words


@pytest.mark.parametrize("moves", [[0.1], [0.1, 0.1, 0.7], [0.0, 0.0, 0.3], [0.0]])
def test_few_displacements_are_drawn_too(moves):
    share, _ = moved(np.array(moves))
    assert np.isfinite(share).all()
    assert np.abs(share).max() <= 0.4
    if max(moves):
        assert share.max() > 0.1


@pytest.mark.parametrize("shape", [(4, 9, 3), (12, 3, 5), (3, 4, 14)])
def test_no_text_of_the_velocity_figure_lies_over_another(shape):
    figure = velocity_figure(field(shape))
    FigureCanvasAgg(figure).draw()
    boxes = [
        (text.get_text(), text.get_window_extent())
        for axes in figure.axes
        for text in (*axes.texts, axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label)
        if text.get_text()
    ]
    assert len(boxes) == 12  # of each panel a title, an arrow's length, two axes
    over = [(a, b) for (a, one), (b, other) in combinations(boxes, 2) if one.overlaps(other)]
    assert over == []


@pytest.mark.full
def test_a_figure_is_cut_between_its_panels():
    figure = velocity_figure(field())
    whole = Image.open(io.BytesIO(png(figure)))
    parts = [Image.open(io.BytesIO(part)) for part in Drawn.of(figure).panels]
    assert len(parts) == 3
    drawn = [np.asarray(part.convert("L")) < 255 for part in parts]
    assert sum(part.sum() for part in drawn) == (np.asarray(whole.convert("L")) < 255).sum()  # nothing is lost
    for part in drawn:
        assert part[[0, -1]].any(1).all()
        assert part[:, [0, -1]].any(0).all()  # no margins


@pytest.mark.full
def test_a_second_axis_belongs_to_its_panel_and_one_panel_is_whole():
    figure = Figure(figsize=(6, 2), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.twinx().set_ylabel("more")
    right.plot([0, 1], [0, 1])
    assert len(Drawn.of(figure).panels) == 2
    one = Figure(figsize=(3, 2), layout="constrained")
    one.subplots().plot([0, 1], [0, 1])
    assert Drawn.of(one).panels == [png(one)]
    assert len(Drawn.of(histogram_figure(field(), (0.1, 0.1, 0.1), 5e-4)).panels) == 3


def test_the_sheet_of_views_says_what_it_shows():
    axis = np.arange(20.0)
    figure = contact_sheet([[np.ones((20, 20), np.float32)]], axis[:1], axis[:1], axis, axis[::-1], "a.tif")
    assert "a.tif: sub-aperture views" in figure.get_suptitle()
    caption = figure.get_supxlabel().replace("\n", " ")
    assert "shows 20 x 20 mm of the focal plane" in caption
    assert "white 1 counts and more" in caption
