"""The paper's cameras by name, and what their names promise."""

import pytest

from plenopiv.cameras.presets import PRESETS, preset
from plenopiv.errors import PlenoPIVError


@pytest.mark.parametrize(
    ("name", "pmr", "aperture_mm"), [("pmr8", 8, 100 / 7), ("pmr14", 14, 25.0), ("pmr28", 28, 50.0)]
)
def test_small_cameras(name, pmr, aperture_mm):
    camera = preset(name)
    assert camera.pixels_per_microlens == pytest.approx(pmr)
    assert camera.main_lens.aperture_mm == pytest.approx(aperture_mm)
    assert preset(name, aperture="table").main_lens.aperture_mm == 25.0
    assert (camera.sensor.columns, camera.sensor.rows) == (448, 448)


@pytest.mark.parametrize("name", PRESETS)
def test_optics_of_every_preset(name):
    camera = preset(name)
    assert camera.main_lens.object_distance_mm == pytest.approx(100.0)
    assert camera.main_lens.image_distance_mm == pytest.approx(100.0)
    # matched f-numbers: the aperture's image is as wide as the microlens
    assert 2 * camera.aperture_radius_px == pytest.approx(camera.pixels_per_microlens)


def test_29_megapixel_camera():
    camera = preset("29mp")
    assert camera.sensor.columns * camera.sensor.rows == 29_040_000
    assert camera.lattice.kind == "hexagonal"
    assert camera.dead_zone_mm() == pytest.approx((-0.308, 0.308), abs=0.002)


def test_lattice_can_be_chosen_and_names_are_checked():
    assert preset("pmr14", lattice="hexagonal").lattice.kind == "hexagonal"
    with pytest.raises(PlenoPIVError, match="'pmr14'"):
        preset("pmr 14")
    with pytest.raises(PlenoPIVError, match="matched"):
        preset("pmr14", aperture="full")
