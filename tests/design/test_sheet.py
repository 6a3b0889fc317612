"""What a camera will do, from its geometry: limits, closed forms, trends."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.depth import coarsest_voxel_mm
from plenopiv.cameras.presets import preset
from plenopiv.design.advice import suggested
from plenopiv.design.sheet import design, optics, overlap
from plenopiv.design.variants import variants
from plenopiv.errors import PlenoPIVError


def test_one_particle_a_microlens_lights_each_pixel_once_in_focus_and_more_often_out_of_it():
    camera = preset("pmr14")
    assert overlap(camera, (-1e-6, 1e-6)) == pytest.approx(1.0, abs=1e-4)
    # a footprint one microlens wide covers four cells: |A| P_m / PMR = p at |z| = PMR f_l / M^2, to first order
    z = 14 * 0.308
    assert overlap(camera, (z - 1e-6, z + 1e-6)) == pytest.approx(4.0, rel=0.05)


def test_numbers_of_the_papers_camera():
    found = optics(preset("pmr14"), (-2.0, 2.0))
    assert found.views == round(pi * 7**2)
    assert found.microlenses == pytest.approx(448**2 / 14.043**2, rel=0.01)  # micro-images are 14.043 px apart
    assert found.dead_zone_mm == pytest.approx((-0.309, 0.307), abs=5e-4)
    for depth in found.depths:
        x, y = seen_by_every_view_mm(preset("pmr14"), depth.z_mm)
        assert depth.field_mm == pytest.approx((2 * float(x), 2 * float(y)))
    middle = found.depths[len(found.depths) // 2]
    assert (middle.z_mm, middle.across_mm, middle.in_depth_mm) == pytest.approx((0.0, 0.0385, 0.154), rel=0.01)


def test_the_volume_is_what_every_view_sees_and_windows_are_longer_than_particles_images():
    for name in ("pmr8", "pmr14", "29mp"):
        camera = preset(name)
        found = suggested(camera)
        (_, x), (_, y), depth = found.limits_mm
        seen = [min(side) for side in seen_by_every_view_mm(camera, depth)]
        assert x <= seen[0]
        assert y <= seen[1]
        near, far = camera.dead_zone_mm()
        assert found.window_mm[2] > 2.9 * (far - near) / 2  # at 2.3 displacements came out 40 % too small


def test_few_pixels_to_a_microlens_take_finer_voxels_and_windows_as_large():
    """As fine beside a microlens as those of the paper's camera of PMR 14."""
    paper, few = suggested(preset("pmr14")), suggested(preset("pmr8"))
    assert suggested(preset("pmr28")).voxel_mm[0] == paper.voxel_mm[0]
    assert few.voxel_mm[0] == pytest.approx(paper.voxel_mm[0] * 8 / 14)
    assert few.window_mm[:2] == pytest.approx(paper.window_mm[:2])
    for name in ("pmr8", "pmr14", "pmr28", "29mp"):
        assert suggested(preset(name)).voxel_mm[0] < coarsest_voxel_mm(preset(name))


def test_variants_change_one_thing_and_keep_f_numbers_matched():
    camera = preset("pmr14")
    found = dict(variants(camera))
    assert len(found) == 7
    for other in found.values():
        assert other.main_lens.aperture_mm == pytest.approx(other.matched_aperture_mm)
    assert found["PMR 20"].sensor == camera.sensor
    assert found["PMR 20"].pixels_per_microlens == pytest.approx(20)
    finer = next(other for name, other in found.items() if name.startswith("pitch 54"))
    assert finer.pixels_per_microlens == pytest.approx(14)
    assert finer.sensor.columns * finer.sensor.pixel_pitch_mm == pytest.approx(448 * 0.0055, rel=0.01)
    assert found["hexagonal lattice"].lattice.kind == "hexagonal"


def test_variants_move_what_they_should():
    found = design(preset("pmr14"), (-2.0, 2.0))
    by_name = {other.name: other for other in found.variants}
    end = -1  # the depth farthest toward the camera
    assert by_name["PMR 20"].depths[end].in_depth_mm < found.optics.depths[end].in_depth_mm
    assert by_name["PMR 20"].microlenses < found.optics.microlenses < by_name["PMR 10"].microlenses
    for m in (0.5, 2.0):  # the dead zone is f_l / M^2, to first order
        assert by_name[f"M = {-m:g}"].dead_zone_mm[1] == pytest.approx(0.308 / m**2, rel=0.02)
    assert found.best is None


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"aperture_mm": 30.0}, "overlap; matched at an aperture of 25 mm"),
        ({"aperture_mm": 20.0}, "leave pixels between them dark; matched at an aperture of 25 mm"),
    ],
)
def test_an_aperture_that_does_not_fit_is_refused(change, expected):
    camera = preset("pmr14")
    with pytest.raises(PlenoPIVError, match=expected):
        design(replace(camera, main_lens=replace(camera.main_lens, **change)))


def test_a_depth_that_holds_the_lens_or_nothing_is_refused():
    for depth in ((-2.0, 120.0), (2.0, -2.0)):
        with pytest.raises(PlenoPIVError, match="must rise and end before the main lens, which is at z = 100 mm"):
            design(preset("pmr14"), depth)
    with pytest.raises(PlenoPIVError, match="is too deep: every view sees"):
        design(preset("pmr14"), (-12.0, 12.0))


def test_pairs_of_fields_pool_like_one():
    from plenopiv.accuracy.velocity import Band, Errors, Score, pooled

    rng = np.random.default_rng(3)
    parts = [rng.normal(0.02, 0.1, (n, 3)) for n in (40, 10)]

    def errors(e):
        rms, bias = tuple(np.sqrt((e**2).mean(0))), tuple(e.mean(0))
        return Errors(1.0, 0.0, rms, bias, (Band(0.0, 1.0, len(e), rms, bias),))

    scores = [Score(len(e), 0, 9.0, errors(e), None, None, None, None, None, None, (1.0,) * 3) for e in parts]
    found, wanted = pooled(scores), errors(np.concatenate(parts))
    assert found.rms == pytest.approx(wanted.rms)
    assert found.bias == pytest.approx(wanted.bias)
    assert found.by_depth[0].rms == pytest.approx(wanted.rms)
    assert found.by_depth[0].vectors == 50
    lost = replace(scores[1], final=Errors(0.5, 1.0, (np.nan,) * 3, (np.nan,) * 3, ()))  # every vector gross
    found = pooled([scores[0], lost])
    assert (found.rms, found.bias) == (pytest.approx(scores[0].final.rms), pytest.approx(scores[0].final.bias))
    assert (found.answered, found.gross) == (pytest.approx(45 / 50), pytest.approx(5 / 45))
    assert np.isnan(pooled([lost]).rms).all()
