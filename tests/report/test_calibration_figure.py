"""The figure of a calibration with a target: its numbers, and where they stand."""

from dataclasses import replace

import numpy as np
from calibrations import calibrated
from matplotlib.quiver import Quiver

from plenopiv.report.calibration import calibration_figure
from plenopiv.report.figures import png


def panels(calibration):
    """Axes by the beginnings of their titles."""
    return {axes.get_title(): axes for axes in calibration_figure(calibration).axes if axes.get_title()}


def test_planes_are_drawn_in_the_order_of_their_depth():
    made = calibrated()
    axes = panels(replace(made, planes=made.planes[::-1]))["left-out residual, RMS"]
    for line, k in zip(axes.get_lines(), range(2), strict=True):
        np.testing.assert_array_equal(line.get_xdata(), [plane.z_mm for plane in made.planes])
        np.testing.assert_array_equal(line.get_ydata(), [plane.rms_um[k] for plane in made.planes])


def test_a_shift_to_the_right_and_up_is_drawn_so():
    """Rows count downward: the view of pixel (0, -3) is the upper one."""
    axes = panels(replace(calibrated(), views_um=((0, -3, 0.2, 0.0), (3, 0, 0.0, 0.4))))[
        "mean shift of all dots in each view"
    ]
    (arrows,) = [each for each in axes.get_children() if isinstance(each, Quiver)]
    np.testing.assert_array_equal(arrows.XY, [[0, 3], [3, 0]])
    assert arrows.U.tolist() == [0.2, 0.0]
    assert arrows.V.tolist() == [0.0, 0.4]


def test_the_field_has_plus_y_at_the_top_and_plus_x_at_the_right():
    rows = [[(1.0, 0, 0), (2.0, 0, 0), (3.0, 0, 0)], [(4.0, 0, 0)] * 3, [(5.0, 0, 0)] * 3]
    axes = panels(replace(calibrated(), field_um=rows))["residual of x over the field, RMS"]
    words = {(text.get_position()): text.get_text() for text in axes.texts}
    assert [words[k, 0] for k in range(3)] == ["1.00", "2.00", "3.00"]
    assert words[0, 2] == "5.00"
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # row 0 at the top
    assert [label.get_text() for label in axes.get_yticklabels()] == ["+y", "", "-y"]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["-x", "", "+x"]


def test_it_draws_what_nobody_measured():
    """A plane without whole dots, no views."""
    assert png(calibration_figure(replace(calibrated(), views_um=()))).startswith(b"\x89PNG")
