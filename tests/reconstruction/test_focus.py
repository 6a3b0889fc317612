"""How light near focus counts in the correlation."""

import numpy as np
from oracles.cameras import small_camera

from plenopiv.reconstruction.focus import LEAST, focus_weight, near_focus


def test_weight_grows_from_focus_to_one_at_the_reach():
    camera = small_camera("hexagonal")
    below, above = camera.dead_zone_mm()
    z = np.array([0.0, 0.75 * above, 1.5 * above, 3 * above, 5 * above, 0.75 * below, 3 * below, -4.0])
    np.testing.assert_allclose(focus_weight(camera, z, 3.0), [LEAST, 0.125, 0.5**1.5, 1, 1, 0.125, 1, 1], rtol=1e-6)
    assert (focus_weight(camera, z, 0.0) == 1).all()


def test_weight_keeps_the_shape_of_depths():
    assert focus_weight(small_camera("square"), np.ones((4, 3, 2)), 2.0).shape == (4, 3, 2)


def test_a_window_is_near_focus_where_its_middle_half_reaches_into_it():
    camera = small_camera("hexagonal")
    below, above = camera.dead_zone_mm()
    ends = np.array([(1.4, 3), (1.6, 3), (-2.0, 1.6), (-3, -1.6), (-3, -1.4), (1.4, 1.45)])
    ends = np.where(ends > 0, ends * above, -ends * below)
    near = [True, False, True, False, True, True]
    assert near_focus(camera, *ends.T).tolist() == near
    assert near_focus(camera, *ends[:, ::-1].T).tolist() == near  # whichever end is the nearer
