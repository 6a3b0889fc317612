"""Rays of the drawn Figs. 1, 2 and 8 go where the ray-transfer matrices send them."""

from pathlib import Path

import numpy as np
import pytest

from plenopiv.optics import microlens_offset, propagation, thin_lens

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "paper"))


@pytest.mark.parametrize(("y", "z", "v"), [(4.0, 22.0, 8.0), (0.0, 0.0, 12.0), (-3.0, -15.0, -6.5), (1.5, 26.0, 0.3)])
def test_a_ray_is_that_of_the_matrices(y, z, v):
    """Eqs. 1 to 5 of the paper, of a ray in the plane of y and phi."""
    from schematics import LARGE, ray_of

    lens, focal = LARGE.main_lens, LARGE.microlens_focal_length_mm
    far = lens.object_distance_mm - z
    ray = np.array([0.0, y, 0.0, (v - y) / far])
    ray = propagation(lens.image_distance_mm) @ thin_lens(lens.focal_length_mm) @ propagation(far) @ ray
    found = ray_of(LARGE, y, z, v)
    assert found.t == pytest.approx(ray[1], abs=1e-9)
    assert abs(found.t - found.lens) <= 0.5 * LARGE.lattice.pitch_mm
    behind = propagation(focal) @ (thin_lens(focal) @ ray + microlens_offset((0.0, found.lens), focal))
    assert found.sensor == pytest.approx(behind[1], abs=1e-9)


def test_in_focus_a_pixel_sees_one_portion_of_the_main_lens():
    """The portions of Fig. 8 are those of the pixels, in the opposite order."""
    from schematics import LARGE, PIXELS, portions

    for number, rays in enumerate(portions(LARGE, 0.0, 0.0)):
        for ray in rays:
            pixel = np.floor(ray.sensor / LARGE.sensor.pixel_pitch_mm + 0.5 * PIXELS)
            assert pixel == PIXELS - 1 - number


def test_the_figures_are_written(tmp_path):
    import schematics

    schematics.main(tmp_path, True)
    for name in ("fig01-camera", "fig02-ray", "fig08-drt"):
        picture = (tmp_path / "docs" / "images" / "paper" / f"{name}.png").read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) < 200_000
