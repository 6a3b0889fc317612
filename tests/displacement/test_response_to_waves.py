"""How much of a wave vectors keep: limiting cases, the passes written out along a line, and particles."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.overlap import fade
from plenopiv.displacement.predictor import fit_spline, smooth_predictor
from plenopiv.displacement.resolution import averaged_share, effective_window, response
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.sub_windows import mean_weights
from plenopiv.displacement.windows import window_grid
from plenopiv.volume import DenseVolume, VoxelGrid

DEFAULT = CorrelationSettings()
SINGLE = replace(DEFAULT, inner_window=(64, 64, 16))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("windows", [1.0, 1.7, 3.0])
def test_one_pass_is_the_mean_over_the_window(axis, windows):
    """The sum of a wave over n voxels: sin(k n/2) / (n sin(k/2))."""
    one = CorrelationSettings(windows=((32, 24, 16),), inner_window=(32, 24, 16), fine_passes=1, taper_voxels=0.0)
    n = (32, 24, 16)[axis]
    k = 2 * np.pi / (windows * n)
    assert response(one, axis, windows * n) == pytest.approx(np.sin(k * n / 2) / (n * np.sin(k / 2)))


def along_a_line(settings, wavelength):
    """The passes on a displacement that is a wave along x, windows of which are means over voxels."""
    total = 64 * 24
    wave = 2 * np.pi / wavelength * (np.arange(total) - (total - 1) / 2)
    flow, predictor, z = np.cos(wave), None, np.zeros(1)
    plan = [window_grid((8, 8, total), (each.window[0], 8, 8), each.overlap) for each in settings.passes]
    for number, windows in enumerate(plan):
        weight = fade(windows.size[2], settings.taper_voxels) ** 2
        x, starts = windows.centres[2], windows.starts[2]
        known = 0 * flow if predictor is None else predictor.at(z, z, np.arange(total))[0, 0, 0]
        at = 0 * x if predictor is None else predictor.at(z, z, x)[0, 0, 0]
        found = at + [weight @ (flow - known)[s : s + len(weight)] / weight.sum() for s in starts]
        if number < len(plan) - 1:
            field = np.broadcast_to(found, (3, 1, 1, len(found)))
            if settings.filter_predictor:
                field = smooth_predictor(field, settings.passes[number].overlap)
            predictor = fit_spline(field, windows.centres, (8, 8, total))
    whole = plan[-1]
    if settings.sub_window is not None:
        whole = window_grid((8, 8, total), (settings.windows[-1][0], 8, 8), settings.overlap)
        found = mean_weights(whole, plan[-1], True, averaged_share(settings))[2] @ found
    x = whole.centres[2]
    inside = np.abs(x - (total - 1) / 2) < total / 4
    return np.linalg.lstsq(np.cos(2 * np.pi / wavelength * (x - (total - 1) / 2))[inside, None], found[inside])[0][0]


@pytest.mark.parametrize("settings", [DEFAULT, SINGLE, replace(DEFAULT, inner_overlap=0.5, filter_predictor=False)])
@pytest.mark.parametrize("windows", [1.5, 2.0, 3.0, 4.0])
def test_response_is_that_of_the_passes_written_out(settings, windows):
    assert response(settings, 0, 64 * windows) == pytest.approx(along_a_line(settings, 64 * windows), abs=0.025)


@pytest.mark.parametrize(
    "settings",
    [
        DEFAULT,
        replace(DEFAULT, inner_overlap=0.5),
        replace(DEFAULT, inner_window=(40, 40, 10)),
        CorrelationSettings(windows=((48, 32, 16),)),
    ],
)
def test_means_over_sub_windows_resolve_what_the_window_does(settings):
    assert effective_window(settings) == pytest.approx(settings.windows[-1], rel=1e-3)
    assert all(0.25 < share < 1.0 for share in averaged_share(settings))


def test_a_single_window_resolves_more_than_its_mean():
    assert averaged_share(SINGLE) == (1.0, 1.0, 1.0)
    x, y, z = effective_window(SINGLE)
    assert x == y
    assert 40 < x < 50
    assert z < 16


def test_long_waves_are_kept_whole():
    assert response(DEFAULT, 0, 64e3) == pytest.approx(1.0, abs=1e-5)


def test_sub_windows_as_large_as_can_be_are_averaged_over_a_quarter_at_least():
    """Windows a voxel smaller than the last ones: their own mean is too wide, and a smaller share makes no other."""
    nearly = replace(DEFAULT, inner_window=(63, 63, 16), inner_overlap=0.5, fine_passes=1)
    assert min(averaged_share(nearly)) >= 0.25


@pytest.mark.full
@pytest.mark.parametrize(("axis", "across"), [(0, 1), (0, 2), (2, 0)])
def test_particles_show_the_response(axis, across):
    """Waves of 1.5, 2 and 3 windows across the displacement, 36 particles in a window of 32 x 32 x 16."""
    settings = CorrelationSettings(windows=((64, 64, 32), (32, 32, 16)))
    last = settings.windows[-1]
    for windows, least in ((1.5, 0.37), (2.0, 0.60), (3.0, 0.80)):
        wavelength, found, true = windows * last[axis], 0.0, 0.0
        for seed in range(2):
            field, wave = measured_wave(settings, axis, across, wavelength, seed)
            found, true = found + (field * wave).sum(), true + (wave * wave).sum()
        assert least < found / true < 1.03
        assert found / true == pytest.approx(response(settings, axis, wavelength), abs=0.05)


def measured_wave(settings, axis, across, wavelength, seed):
    """Displacement along ``across`` at vectors away from the faces, and the true wave there, of .5 voxel."""
    rng, shape = np.random.default_rng(seed), ((64, 80, 192) if axis == 0 else (144, 80, 96))
    middle, drift = (np.array(shape[::-1]) - 1) / 2, np.array([2.3, -1.4, 0.37])
    count = rng.poisson(36 / (32 * 32 * 16) * np.prod(np.array(shape) + 16))
    at = rng.uniform(-8.5, np.array(shape[::-1]) + 7.5, (count, 3))
    wave = 2 * np.pi / wavelength

    def moved(place):
        return drift + 0.5 * np.sin(wave * (place[:, axis, None] - middle[axis])) * (np.arange(3) == across)

    volumes = [rendered(shape, at + side * moved(at)) for side in (-0.5, 0.5)]
    field = measure(*volumes, settings)
    axes = (field.x, field.y, field.z)
    place = np.stack(np.meshgrid(*axes[::-1], indexing="ij")[::-1], -1).reshape(-1, 3)
    n, size = shape[2 - axis], settings.windows[-1][axis]
    inside = (place[:, axis] > size) & (place[:, axis] < n - 1 - size)
    return (
        (field.displacement.reshape(3, -1)[across] - drift[across])[inside],
        (moved(place)[:, across] - drift[across])[inside],
    )


def rendered(shape, at):
    """Gaussians of one voxel at ``at`` (n, 3)."""
    values = np.zeros(np.array(shape) + 32, np.float32)
    near = np.arange(-4, 5)
    for place in at:
        whole = np.round(place).astype(int)
        x, y, z = (np.exp(-0.5 * (whole[k] + near - place[k]) ** 2) for k in range(3))
        i, j, k = (slice(n + 12, n + 21) for n in whole)
        values[k, j, i] += z[:, None, None] * y[:, None] * x
    nz, ny, nx = shape
    cut = np.ascontiguousarray(values[16 : 16 + nz, 16 : 16 + ny, 16 : 16 + nx])
    return DenseVolume(VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), shape), cut)
