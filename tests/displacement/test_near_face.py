"""Vectors at the front and the back of a volume."""

import numpy as np
import pytest

from plenopiv.displacement.field import near_face


def test_the_first_and_the_last_layer_of_windows_side_by_side_and_half_a_window_apart():
    assert near_face(np.array([7.5, 23.5, 39.5, 55.5]), 64, 16).tolist() == [True, False, False, True]
    assert near_face(np.arange(7.5, 56, 8.0), 64, 16).tolist() == [True, False, False, False, False, False, True]


@pytest.mark.parametrize("planes", [16, 20])
def test_one_layer_of_windows_reaches_both_faces(planes):
    assert near_face(np.array([0.5 * planes - 0.5]), planes, 16).all()
