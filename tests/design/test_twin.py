"""Twins: their sensors see what they measure, and a good camera's twin measures well."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.presets import preset
from plenopiv.design.advice import suggested
from plenopiv.design.twin import cut, inclined, reconstructed_pair, twin


def test_a_large_sensor_is_cut_to_what_some_vectors_take():
    camera = preset("29mp")
    asked = suggested(camera)
    small, measured = cut(camera, asked, vectors=60)
    assert small.sensor.columns < camera.sensor.columns / 4
    assert measured.limits_mm[2] == asked.limits_mm[2]
    assert measured.windows == asked.windows
    x, y = (float(min(side)) for side in seen_by_every_view_mm(small, measured.limits_mm[2]))
    assert measured.limits_mm[0][1] <= x < 1.05 * measured.limits_mm[0][1]
    assert measured.limits_mm[1][1] <= y < 1.05 * measured.limits_mm[1][1]


def test_a_small_sensor_is_its_own_twin():
    camera = preset("pmr14")
    asked = suggested(camera)
    small, measured = cut(camera, asked, vectors=10_000)
    assert (small.sensor.columns, small.sensor.rows) == (448, 448)
    assert measured == asked


def test_errors_in_depth_lean_with_the_lines_of_sight():
    camera = preset("29mp")
    asked = suggested(camera)
    _, part = cut(camera, asked, vectors=60)
    assert inclined(camera, asked, asked) == (0.0, 0.0)
    slope_x, slope_y = inclined(camera, asked, part)
    assert slope_x > slope_y > 0  # the sensor is wider than high
    # brute force: points all over the field, moved along their line of sight by a voxel in depth
    x = np.linspace(*asked.limits_mm[0], 2001)
    per_voxel = x / 100.0 * asked.voxel_mm[2] / asked.voxel_mm[0]
    inner = np.linspace(*part.limits_mm[0], 2001) / 100.0 * asked.voxel_mm[2] / asked.voxel_mm[0]
    assert slope_x**2 == pytest.approx(np.mean(per_voxel**2) - np.mean(inner**2), rel=2e-3)


@pytest.fixture(scope="module")
def shallow():
    camera = preset("pmr14")
    camera = replace(camera, sensor=replace(camera.sensor, columns=520, rows=520))
    return camera, suggested(camera, (-1.6, 1.6))


@pytest.mark.full
def test_twins_follow_from_their_seed_and_measure_motion_with_its_signs(shallow):
    camera, asked = shallow
    pair = reconstructed_pair(camera, asked, vectors=10, seed=4)
    unweighted = replace(pair.chain, reconstruction=replace(pair.chain.reconstruction, focus_reach=0.0))
    field = replace(pair, chain=unweighted).velocity().isel(time=0)
    again = reconstructed_pair(camera, asked, vectors=10, seed=4)
    np.testing.assert_array_equal(pair.frames[0].volume.values, again.frames[0].volume.values)
    assert pair.moved_mm[0] > 0 > pair.moved_mm[1]
    for name, moved, voxel in zip("uvw", pair.moved_mm, asked.voxel_mm, strict=True):
        measured_mm = 1e3 * 5e-4 * float(field[name].median())
        assert measured_mm == pytest.approx(moved, abs=0.25 * voxel)


@pytest.mark.full
def test_twin_gathers_pairs_until_there_are_vectors_enough(shallow):
    camera, asked = shallow
    found = twin(camera, asked, vectors=60)
    assert found.pairs == 2
    assert found.vectors >= 0.9 * 60
    assert found.errors.gross == 0.0
    assert max(found.errors.rms[:2]) < 0.15
    assert len(found.planes) == len({plane.z_mm for plane in found.planes}) > 1
    assert 0 < found.candidates < 0.3
