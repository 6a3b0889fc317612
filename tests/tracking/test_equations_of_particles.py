"""Normal equations of particles that share pixels, and lists of pixels: against dense matrices in plain NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from particle_scenes import CAMERA, GAIN, LIMITS, noisy, pixels_of, seeded

from plenopiv.threads import one_thread
from plenopiv.tracking import entry_kernels, steps
from plenopiv.tracking.equations import normal_equations, own_equations
from plenopiv.tracking.evidence import errors_of
from plenopiv.tracking.light import UNIT_MM, PointLights, prior_std_mm
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.refine import Effort, Prior, fit_light, refine

PIXELS = CAMERA.sensor.columns * CAMERA.sensor.rows


@pytest.fixture(scope="module")
def scene():
    truth = seeded(0.3)
    lights, light = PointLights(CAMERA)(truth.position_mm), GAIN * truth.electrons
    rng = np.random.default_rng(2)
    weight = np.where(rng.random(PIXELS) > 0.1, rng.uniform(0.05, 0.3, PIXELS), 0.0).astype(np.float32)
    return lights, light, weight, rng.normal(0.0, 1.0, PIXELS).astype(np.float32)


def dense(lights, values):
    """(points, pixels), entry by entry."""
    out = np.zeros((len(lights.start) - 1, PIXELS))
    for n in range(len(out)):
        for e in range(lights.start[n], lights.start[n + 1]):
            out[n, lights.pixel[e]] += values[e]
    return out


def test_equations_are_those_of_dense_matrices(scene):
    lights, light, weight, pull = scene
    columns = [dense(lights, lights.gradient[:, k]) * UNIT_MM[k] for k in range(3)] + [dense(lights, lights.share)]
    jacobian = np.stack(columns, 1) * light[:, None, None] * weight  # (points, 4, pixels)
    whole = np.einsum("ipx,jqx->ipjq", jacobian, jacobian, optimize=True).reshape(4 * len(light), -1)
    normal = normal_equations(lights, light, weight, telling=0.0)
    scale = np.sqrt(np.diag(whole))
    assert normal.toarray() / scale / scale[:, None] == pytest.approx(whole / scale / scale[:, None], abs=1e-5)
    own, slope = own_equations(lights, light, weight, pull)
    right = np.einsum("ipx,x->ip", jacobian, pull.astype(float))
    for n in range(len(light)):
        block = np.zeros((4, 4))
        for e in range(lights.start[n], lights.start[n + 1]):
            row = np.append(lights.gradient[e] * UNIT_MM, lights.share[e]) * light[n] * weight[lights.pixel[e]]
            block += np.outer(row, row)
        assert own[n] == pytest.approx(block, abs=1e-5 * np.abs(block).max())
    assert slope / scale.reshape(-1, 4) == pytest.approx(right / scale.reshape(-1, 4), abs=1e-4)


def test_a_step_solves_the_dense_equations_of_those_that_move(scene, monkeypatch):
    lights, light, weight, pull = scene
    which = np.flatnonzero(np.arange(len(light)) % 3 > 0)
    columns = [dense(lights, lights.gradient[:, k]) * UNIT_MM[k] for k in range(3)] + [dense(lights, lights.share)]
    jacobian = (np.stack(columns, 1) * light[:, None, None] * weight)[which].reshape(4 * len(which), -1)
    own, slope = own_equations(lights, light, weight, pull)
    information = np.tile([0.3, 0.2, 50.0], (len(which), 1))
    added = steps.DAMPING * np.einsum("nii->ni", own[which])
    added[:, :3] += information
    whole = jacobian @ jacobian.T + np.diag(added.ravel())
    right = slope[which]
    monkeypatch.setattr(steps, "TOLERANCE", 1e-6)
    step = steps.step_of(lights, light, weight, which, own[which], information, right)
    scale = np.sqrt(np.diag(whole))
    assert step.ravel() * scale == pytest.approx(np.linalg.solve(whole, right.ravel()) * scale, abs=2e-3)
    with one_thread():
        assert (steps.step_of(lights, light, weight, which, own[which], information, right) == step).all()


def test_entries_that_say_little_are_left_out(scene):
    lights, light, weight, _ = scene
    every, some = (normal_equations(lights, light, weight, **given) for given in ({"telling": 0.0}, {}))
    lost = 1 - some.diagonal() / every.diagonal()
    assert lost.max() < 0.01
    assert 1e-5 < lost.mean() < 0.004
    scale = np.sqrt(every.diagonal())
    assert np.abs((some - every).toarray() / scale / scale[:, None]).max() < 0.01


def test_nothing_is_left_out_of_lights_that_overlap(scene):
    lights, light, weight, _ = scene
    overlapping = replace(lights, overlap=True)
    every = normal_equations(lights, light, weight, telling=0.0)
    assert (normal_equations(overlapping, light, weight) != every).nnz == 0
    assert (
        overlapping.of(np.array([1, 2]))
        .with_others(np.array([0]), overlapping)
        .shifted(np.array([0]), np.zeros((1, 3)))
        .overlap
    )
    assert PointLights(replace(CAMERA, blur_mm=0.02))([[0.0, 0.0, 1.0]]).overlap


def test_particles_whose_pixels_cannot_be_used_have_blocks(scene):
    lights, light, weight, _ = scene
    dark = weight.copy()
    dark[lights.pixel[lights.start[2] : lights.start[3]]] = 0.0
    normal = normal_equations(lights, light, dark)
    assert normal.shape == (4 * len(light), 4 * len(light))
    assert np.isfinite(normal.data).all()
    assert (normal.diagonal().reshape(-1, 4)[2] == 0).all()


def test_light_alone_and_misfits_are_those_of_dense_matrices(scene):
    """With a third of the pixels unusable, and the noise that ``Pixels`` states."""
    lights, light = scene[:2]
    every, usable = dense(lights, lights.share), np.random.default_rng(8).random(PIXELS) > 1 / 3
    counts = np.where(usable, light @ every, 1e6)
    pixels = Pixels(counts, usable, 4.0, GAIN)
    found = fit_light(lights, pixels, light * np.linspace(0.8, 1.3, len(light)), 12)
    assert found == pytest.approx(light, rel=1e-2)
    fit = refine(PointLights(CAMERA), pixels, seeded(0.3).position_mm, 1.1 * light, prior_of(seeded(0.3)), 0)
    _, off = errors_of(fit, usable)
    for n in (0, 5, len(light) - 1):
        total = weight = 0.0
        for e in range(lights.start[n], lights.start[n + 1]):
            if usable[p := lights.pixel[e]]:
                total += lights.share[e] * fit.residual[p] ** 2 / fit.variance[p]
                weight += lights.share[e]
        assert off[n] == pytest.approx(total / weight, rel=1e-6)


def prior_of(truth):
    return Prior(truth.position_mm, prior_std_mm(CAMERA))


def test_lists_of_other_points(scene):
    lights, light = scene[:2]
    which = np.array([3, 0, 5])
    some = lights.of(which)
    joined = lights.with_others(which, some)
    every, slopes = dense(lights, lights.share), dense(lights, lights.gradient[:, 2])
    assert (dense(some, some.share) == every[which]).all()
    assert (dense(joined, joined.share) == every[[*which, *which]]).all()
    order = np.arange(len(light))
    order[[1, 4, 6]] = which
    roomy = lights.replaced(np.array([1, 4, 6]), some)
    assert (dense(roomy, roomy.gradient[:, 2]) == slopes[order]).all()
    assert roomy is not lights
    assert (dense(lights, lights.share) == every).all()
    assert roomy.replaced(np.array([1, 4, 6]), lights.of(np.array([1, 4, 6]))) is roomy  # there is room
    assert (dense(roomy, roomy.gradient[:, 2]) == slopes).all()
    assert (dense(roomy, roomy.share) == every).all()
    weight = scene[2]
    for telling in (0.0, 0.03):  # room makes no difference
        one, other = (normal_equations(each, light, weight, telling) for each in (lights, roomy))
        assert (one.indices == other.indices).all()
        assert other.data == pytest.approx(one.data, rel=1e-5, abs=1e-6 * float(np.abs(one.data).max()))
    none = roomy.replaced(np.array([2]), PointLights(CAMERA)(np.array([[9.0, 9.0, 1.0]])))  # beside the sensor
    assert (dense(none, none.share)[2] == 0.0).all()
    assert lights.image(light, PIXELS) == pytest.approx(light @ every, rel=1e-9)


def test_pixels_that_are_lit_are_numbered(scene):
    lights = scene[0].of(np.array([3, 0, 5]))
    lit, own = lights.of_lit()
    assert (lit == np.unique(lights.pixel)).all()
    assert (lit[own.pixel] == lights.pixel).all()
    values, some = np.zeros(8), np.array([1, 4, 5, 9, 11, 12, 40, 41])
    entry_kernels.add_where(np.array([0, 4, 6, 12, 41, 50]), np.arange(1.0, 7.0), some, values)
    assert values.tolist() == [0.0, 2.0, 0.0, 0.0, 0.0, 4.0, 0.0, 5.0]


def test_particles_at_rest_stay_and_the_others_come_to_the_same_places():
    """Refined with rest and without, from the same errors: a few hundredths of a standard deviation apart."""
    truth = seeded(0.5)
    pixels = pixels_of(noisy(truth.position_mm, truth.electrons))
    beyond = np.abs(truth.position_mm[:, 2]) > 0.5
    start = truth.position_mm + np.random.default_rng(4).normal(0.0, (2e-3, 2e-3, 1e-2), truth.position_mm.shape)
    of_points, prior = PointLights(CAMERA), Prior(start, prior_std_mm(CAMERA))
    light = GAIN * truth.electrons
    every = refine(of_points, pixels, start, light, prior, 8)
    rested = refine(of_points, pixels, start, light, prior, 8, Effort(0.03))
    variance = np.linalg.inv(every.normal().toarray())
    std = np.sqrt(np.diag(variance)).reshape(-1, 4)[:, :3] * UNIT_MM
    inside = (np.abs(start) < np.array(LIMITS)[:, 1]).all(1) & beyond
    apart = np.abs(rested.position_mm - every.position_mm)[inside] / std[inside]
    assert np.quantile(apart, 0.95) < 0.1
    again = refine(of_points, pixels, rested.position_mm, rested.light, prior, 1, Effort(1e3))
    assert (again.position_mm == rested.position_mm).all()
    assert (again.light == rested.light).all()


def test_a_particle_whose_pixels_are_all_unusable_has_a_block_of_its_own(scene):
    """Without one more blocks were written than there was room for."""
    lights, light, weight, _ = scene
    lost = len(light) // 2
    weight = weight.copy()
    weight[lights.pixel[lights.start[lost] : lights.start[lost + 1]]] = 0.0
    found = normal_equations(lights, light, weight)
    row = np.repeat(np.arange(len(light)), np.diff(found.indptr))
    assert row[found.indices == row].tolist() == list(range(len(light)))
    assert found.indptr[-1] == len(found.indices) == len(found.data)
    assert np.abs(found.toarray()[4 * lost : 4 * lost + 4]).max() == 0.0
