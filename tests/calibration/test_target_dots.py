"""A dot in the views of a light field: its table, its fit, and which dot is which."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.calibration.target.board import Board
from plenopiv.calibration.target.dot_image import DotImages
from plenopiv.calibration.target.dot_table import DotTable
from plenopiv.calibration.target.find import find_spots
from plenopiv.calibration.target.numbering import numbered, on_grid, origin_of
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.lightfield import decode, layout
from plenopiv.sensor import Sensor
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_images import target_image
from plenopiv.simulation.targets import DotTarget

LENS = MainLens(50.0, 22.0, -1.0)
BOARD = Board(0.45, 0.2, 0.36, 0.28)
KINDS = {"hexagonal": 0.01, "square": -0.02}  # and how the rows are turned


def camera_of(kind):
    lattice = Lattice(kind, 0.077, KINDS[kind], (0.02, -0.01))
    return PlenopticCamera(LENS, lattice, 0.308, Sensor(336, 280, 0.0055, 12, 60))


@pytest.fixture(scope="module", params=KINDS)
def seen(request):
    """A light field of the target at z = 1.5 mm, a little aside."""
    camera, target = camera_of(request.param), DotTarget(0.45, 0.2, 0.36, 0.28)
    light = target_image(RealCamera.of(camera), target, 1.5, 2000.0, samples=200)
    noise = np.random.default_rng(1).normal(0, 3, light.shape)
    return decode(np.rint(light + noise + 60), layout(camera))


@pytest.mark.parametrize("kind", KINDS)
def test_the_table_is_the_share_of_points_in_the_cell(kind):
    """Drawn points of the disc, each spread over the pixel's square: how many fall into the microlens' cell."""
    table, rng = DotTable.of(kind, 1.2, 0.2), np.random.default_rng(2)
    r, angle = 1.2 * np.sqrt(rng.random(200_000)), rng.uniform(0, 2 * np.pi, 200_000)
    points = np.column_stack([r * np.cos(angle), r * np.sin(angle)]) + rng.uniform(-0.2, 0.2, (200_000, 2))
    for off, up in ((0.0, 0.0), (0.9, 0.3), (-0.4, 1.3), (1.2, -1.1)):
        x, y = np.abs(points + np.array([off, up])).T
        inside = (x <= 0.5) & ((x + np.sqrt(3) * y <= 1) if kind == "hexagonal" else (y <= 0.5))
        share, along, across = table(np.array([off]), np.array([up]), 0.0)
        assert share[0] == pytest.approx(inside.mean(), abs=2e-3)
        step = 1e-4
        (ahead, _, _), (above, _, _) = (
            table(np.array([off + a]), np.array([up + b]), 0.0) for a, b in ((step, 0), (0, step))
        )
        assert along[0] == pytest.approx((ahead[0] - share[0]) / step, abs=0.01)
        assert across[0] == pytest.approx((above[0] - share[0]) / step, abs=0.01)


def test_dots_are_found_where_they_are(seen):
    spots = find_spots(seen, BOARD, 4.0, "target.tif")
    assert spots.place_mm[0, 2] == pytest.approx(1.5, abs=0.3)
    grid = on_grid(spots.place_mm[:, :2], "target.tif")
    (number,) = numbered([grid], [spots.place_mm], [spots.light], [1.5], BOARD, ["target.tif"])
    assert {(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)} <= set(map(tuple, number.tolist()))
    fit = DotImages(seen).fit(spots.place_mm[grid.dot], BOARD.diameter_mm(number))
    off = fit.place_mm - BOARD.places_mm(number, 1.5)
    whole = fit.found & fit.whole
    assert whole.sum() >= 9
    assert np.abs(off[whole, :2]).max() < 0.8e-3  # mm
    assert np.abs(off[whole, 2]).max() < 8e-3
    assert (np.abs(off[whole]) < 5 * np.hypot(fit.std_mm[whole], [2e-4, 2e-4, 2e-3])).all()
    shift = fit.view_shift_mm[np.isfinite(fit.view_shift_mm[:, 0])]
    assert len(shift) > 50
    assert np.abs(shift).max() < 1.5e-3


def test_a_dot_beyond_the_sensor_is_not_whole(seen):
    fit = DotImages(seen).fit(np.array([[0.0, 0.0, 1.5], [0.45, 0.0, 1.5], [40.0, 0.0, 1.5]]), [0.36, 0.28, 0.2])
    assert fit.found.tolist() == [True, True, False]
    assert fit.whole.tolist() == [True, True, False]


def test_a_hot_pixel_does_not_cut_a_dot(seen):
    hot = replace(seen.layout, lost=np.zeros_like(seen.layout.seen), seen=seen.layout.seen.copy())
    middle = np.argmin(np.hypot(*hot.camera.lattice.centres(*np.divmod(np.arange(hot.lenses), hot.ni)[::-1])))
    hot.lost[3, middle], hot.seen[3, middle] = True, False
    fit = DotImages(replace(seen, layout=hot)).fit(np.array([[0.0, 0.0, 1.5]]), [0.36])
    assert fit.whole.all()


def test_no_target_is_refused(seen):
    noise = np.random.default_rng(3).normal(0, 5, seen.values.shape).astype(np.float32)
    with pytest.raises(PlenoPIVError, match=r"dark\.tif: \d+ dots of a target found, 9 or more are needed"):
        find_spots(replace(seen, values=np.where(seen.layout.seen, noise, 0)), BOARD, 4.0, "dark.tif")


def lattice_of_dots(turn, shift=(0, 0), size=4):
    """Places, numbers and light of dots of a target turned by quarters."""
    number = np.array([(i, j) for i in range(-size, size + 1) for j in range(-size, size + 1)])
    c, s = round(np.cos(turn * np.pi / 2)), round(np.sin(turn * np.pi / 2))
    place = 0.45 * (number + shift) @ np.array([[c, s], [-s, c]])
    light = np.ones(len(number))
    light[(number == (0, 0)).all(1)] = (0.36 / 0.2) ** 2
    light[(number == (1, 0)).all(1)] = (0.28 / 0.2) ** 2
    return np.column_stack([place, np.zeros(len(place))]), number, light


@pytest.mark.parametrize("turn", range(4))
def test_numbers_count_from_the_large_dot_toward_the_middle_sized(turn):
    place, number, light = lattice_of_dots(turn)
    grid = on_grid(place[:, :2], "target.tif")
    (found,) = numbered([grid], [place], [light], [0.0], BOARD, ["target.tif"])
    np.testing.assert_array_equal(found, number[grid.dot])


def test_a_plane_that_hides_the_marked_dots_is_numbered_by_the_others():
    planes = [lattice_of_dots(0, (0.04 * z, 0)) for z in (-1, 0, 1)]
    planes[1][2][:] = 1.0
    grids = [on_grid(place[:, :2], "target.tif") for place, _, _ in planes]
    found = numbered(grids, [p for p, _, _ in planes], [w for _, _, w in planes], [-1, 0, 1], BOARD, ["a", "b", "c"])
    for (_, number, _), grid, of in zip(planes, grids, found, strict=True):
        np.testing.assert_array_equal(of, number[grid.dot])


def test_missing_dots_do_not_break_the_grid():
    place, number, light = lattice_of_dots(0)
    keep = np.random.default_rng(4).random(len(place)) > 0.15
    keep[(number == (0, 0)).all(1) | (number == (1, 0)).all(1)] = True
    grid = on_grid(place[keep, :2], "target.tif")
    (found,) = numbered([grid], [place[keep]], [light[keep]], [0.0], BOARD, ["target.tif"])
    np.testing.assert_array_equal(found, number[keep][grid.dot])


def test_without_an_origin_there_are_no_numbers():
    place, _, light = lattice_of_dots(0)
    grid = on_grid(place[:, :2], "target.tif")
    assert origin_of(grid, np.ones_like(light), BOARD) is None
    with pytest.raises(PlenoPIVError, match=r"none shows the dot of calibration.origin_dot_mm with that of x_dot_mm"):
        numbered([grid], [place], [np.ones_like(light)], [0.0], BOARD, ["target.tif"])


def test_dots_on_no_grid_are_refused():
    place = np.random.default_rng(5).uniform(-2, 2, (60, 2))
    with pytest.raises(PlenoPIVError, match=r"target.tif: only \d+ of 60 dots lie on one square grid"):
        on_grid(place, "target.tif")
