"""Windows, correlation, peaks, spline, deformation and validation against slow obvious oracles."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, RegularGridInterpolator

from plenopiv.displacement import validation
from plenopiv.displacement.agreement import agreement
from plenopiv.displacement.correlation import WindowCorrelator
from plenopiv.displacement.deformation import DeformedPlanes
from plenopiv.displacement.overlap import PLAIN, fade
from plenopiv.displacement.peaks import find_peaks, gaussian_offset, untilted
from plenopiv.displacement.predictor import fit_spline, smooth_predictor
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.validation import find_outliers, normalised_median, replace_invalid
from plenopiv.displacement.windows import WindowBatch, WindowGrid, window_grid
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import DenseVolume, VoxelGrid

# --- windows


def test_windows_cover_the_volume_and_sit_in_its_middle():
    grid = window_grid((104, 374, 513), (64, 64, 16), 0.5)
    assert grid.shape == (12, 10, 15)
    for starts, n, total in zip(grid.starts, grid.size, (104, 374, 513), strict=True):
        before, after = starts[0], total - (starts[-1] + n)
        assert before >= 0
        assert after - before in (0, 1)
        assert after + before < (starts[1] - starts[0])  # no further window would fit


def test_window_centre_is_that_of_its_voxels():
    grid = window_grid((16, 16, 17), (17, 16, 8), 0.5)
    assert grid.centres[2].tolist() == [8.0]
    assert grid.centres[0].tolist() == [3.5, 7.5, 11.5]


def test_window_larger_than_the_volume_names_the_key():
    with pytest.raises(PlenoPIVError, match=r"correlation\.windows: \[64, 64, 16\] is larger .*\[80, 80, 12\]"):
        window_grid((12, 80, 80), (64, 64, 16), 0.5)


@pytest.mark.parametrize(
    ("choice", "key"),
    [
        ({"windows": ()}, "windows"),
        ({"windows": ((32, 32, 4),)}, "windows"),
        ({"windows": ((32, 32, 16), (64, 32, 16))}, "coarse to fine"),
        ({"overlap": 1.0}, "overlap"),
        ({"fine_passes": 0}, "fine_passes"),
        ({"whitening": float("nan")}, "whitening"),
    ],
)
def test_settings_out_of_range(choice, key):
    with pytest.raises(PlenoPIVError, match=key):
        CorrelationSettings(**choice)


# --- correlation and peaks


def naive_correlation(a, b, weight, search):
    """Direct sums over the window, wrapped around, divided by the overlap of the weights."""
    a, b = (weight * (v - (v * weight).sum() / weight.sum()) for v in (a, b))
    one_d = [weight[:, weight.shape[1] // 2, weight.shape[2] // 2]]
    one_d += [weight[weight.shape[0] // 2, :, weight.shape[2] // 2], weight[weight.shape[0] // 2, weight.shape[1] // 2]]
    out = np.zeros([2 * r + 3 for r in search])
    for index in np.ndindex(*out.shape):
        d = [k - r - 1 for k, r in zip(index, search, strict=True)]
        total = 0.0
        for at in np.ndindex(*a.shape):
            there = tuple((p + q) % n for p, q, n in zip(at, d, a.shape, strict=True))
            total += a[at] * b[there]
        for w, q in zip(one_d, d, strict=True):
            n = len(w)
            total /= sum(w[k] * w[k + q] for k in range(n) if 0 <= k + q < n) / sum(w * w)
        out[index] = total
    return out


def normalised(correlator, a, b, cuts=None):
    spectra = correlator.spectra(WindowBatch.of(a), WindowBatch.of(b), cuts)
    z, y, x = spectra.gain
    return correlator.correlation(spectra) * z[:, :, None, None] * y[:, None, :, None] * x[:, None, None]


@pytest.mark.parametrize("taper", [0.0, 2.0])
def test_correlation_is_the_direct_sum(taper):
    """Of whole windows, and of one cut at both ends of different axes beside one that is whole."""
    rng = np.random.default_rng(3)
    a, b = rng.random((2, 2, 6, 5, 9)).astype(np.float32)
    cuts = np.zeros((2, 3, 2))
    cuts[1] = [(1.0, 0.0), (0.0, 1.5), (0.6, 2.2)]
    correlator = WindowCorrelator(a.shape[1:], (1, 2, 2), taper=taper)
    both, whole = normalised(correlator, a, b, cuts), normalised(correlator, a, b)
    np.testing.assert_array_equal(both[0], whole[0])
    for got, n, cut in ((both[0], 0, cuts[0]), (both[1], 1, cuts[1])):
        z, y, x = (fade(size, taper, *c) for size, c in zip(a.shape[1:], cut, strict=True))
        weight = z[:, None, None] * y[:, None] * x
        expected = naive_correlation(a[n].astype(float), b[n].astype(float), weight, (1, 2, 2))
        np.testing.assert_allclose(got, expected, atol=2e-5 * np.abs(expected).max())


def test_what_is_cut_makes_no_difference():
    rng = np.random.default_rng(8)
    a, b = rng.random((2, 1, 8, 9, 10)).astype(np.float32)
    cuts = np.array([[(2.0, 0.0), (0.0, 3.0), (1.0, 0.0)]])
    correlator = WindowCorrelator((8, 9, 10), (1, 2, 2), whitening=0.5, taper=2.0)
    before = normalised(correlator, a, b, cuts)
    for v in (a, b):
        v[:, :2], v[:, :, 6:], v[..., 0] = 9.0, -7.0, 5.0
    np.testing.assert_allclose(normalised(correlator, a, b, cuts), before, rtol=1e-4, atol=1e-5 * before.max())


def test_fade_of_a_cut_axis():
    np.testing.assert_allclose(fade(8, 0.0, 1.0, 2.6), [0, 1, 1, 1, 1, 0, 0, 0])
    expected = np.sin(np.pi / 4 * np.array([0, 0.5, 1.5, 2, 2, 1.5, 0.5, 0])) ** 2
    np.testing.assert_allclose(fade(8, 2.0, 1.0, 1.0), expected, atol=1e-12)


def naive_agreement(a, b):
    """Cell by cell and voxel by voxel, for an axis that is a multiple of four voxels."""
    cells = [n // 4 for n in a.shape]
    light = np.zeros((2, *cells))
    for at in np.ndindex(*a.shape):
        light[(slice(None), *(k // 4 for k in at))] += (a[at], b[at])
    q = np.zeros(cells)
    energy = np.mean((light**2).sum(0) / 2)
    for cell in np.ndindex(*cells):
        common = either = 0.0
        for step in np.ndindex(3, 3, 3):
            near = tuple(min(max(c + s - 1, 0), n - 1) for c, s, n in zip(cell, step, cells, strict=True))
            share = np.prod([(1, 2, 1)[s] / 4 for s in step])
            common += share * light[0][near] * light[1][near]
            either += share * (light[0][near] ** 2 + light[1][near] ** 2) / 2
        q[cell] = common / (either + 1e-3 * energy)
    centres = [4 * np.arange(n) + 1.5 for n in cells]
    at = np.meshgrid(
        *(np.clip(np.arange(n), c[0], c[-1]) for n, c in zip(a.shape, centres, strict=True)), indexing="ij"
    )
    return RegularGridInterpolator(centres, q)(np.stack(at, -1))


def test_agreement_is_its_definition():
    rng = np.random.default_rng(12)
    a, b = rng.random((2, 8, 12, 16)) ** 4
    got = agreement(a[None].astype(np.float32), b[None].astype(np.float32))[0]
    # the floor is a share of the mean after 1 : 2 : 1, which at the ends is not that of the cells
    np.testing.assert_allclose(got, naive_agreement(a, b), rtol=1e-3)


def test_agreement_is_one_for_the_same_light_and_none_for_what_one_window_holds():
    k = np.arange(32.0)
    blob = lambda x: np.exp(-0.5 * ((k[:, None, None] - 16) ** 2 + (k[:, None] - 16) ** 2 + (k - x) ** 2))  # noqa: E731
    a, b = blob(6)[None], (blob(6.2) + blob(26))[None]
    q = agreement(a.astype(np.float32), b.astype(np.float32))[0]
    assert q[16, 16, 6] > 0.95
    assert q[16, 16, 26] < 0.01
    dark = agreement(np.zeros((1, 9, 10, 11), np.float32), np.zeros((1, 9, 10, 11), np.float32))
    assert dark.shape == (1, 9, 10, 11)
    assert np.isfinite(dark).all()


def test_variance_smooths_both_windows():
    a = np.zeros((32, 32, 32), np.float32)
    a[16, 16, 16] = 1
    both = [WindowCorrelator(a.shape, (1, 1, 4), (v, v, v)) for v in (1, 2)]
    sharp, smooth = (normalised(correlator, a[None], a[None])[0, 2, 2] for correlator in both)
    d = np.arange(-5, 6)
    overlap = 1 - np.abs(d) / 32
    for profile, variance in ((sharp, 1.0), (smooth, 2.0)):
        np.testing.assert_allclose(
            profile * overlap / profile[5], np.exp(-(d**2) / (4 * variance)), atol=5e-3
        )  # autocorrelation: twice the variance; the zero mean costs 0.004


def test_no_bias_toward_zero():
    """Normalised, the mean peak of many windows lies where the particles moved; without it, 0.04 voxel short."""
    rng = np.random.default_rng(0)
    n, shift, sigma = 16, 1.5, 1.0
    k = np.arange(n)
    total = 0.0
    correlator = WindowCorrelator((n, n, n), (1, 1, 4))
    for _ in range(300):
        x = rng.uniform(-6, n + 6, (12, 3))
        light = [
            sum(
                np.exp(-0.5 * ((k - p[2]) / sigma) ** 2)[:, None, None]
                * np.exp(-0.5 * ((k - p[1]) / sigma) ** 2)[:, None]
                * np.exp(-0.5 * ((k - p[0] - side * shift) / sigma) ** 2)
                for p in x
            )[None].astype(np.float32)
            for side in (-0.5, 0.5)
        ]
        spectra = correlator.spectra(*map(WindowBatch.of, light))
        total = total + correlator.correlation(spectra)
    d = np.zeros((1, 3))
    peaks_of(np.ascontiguousarray(total), spectra.gain, d, np.zeros(1, np.float32), np.zeros(1, bool))
    assert abs(d[0, 0] - shift) < 0.02
    np.testing.assert_allclose(d[0, 1:], 0, atol=0.02)


def ungained(correlation):
    return tuple(np.ones((1, n), np.float32) for n in correlation.shape[1:])


def peaks_of(correlation, gain, displacement, ratio, found):
    """``find_peaks``, the gain as it is, with room for where and how slanted peaks are, which it returns."""
    place, untilt, power = np.empty((len(found), 3), np.int64), np.empty((len(found), 3, 3)), np.empty((len(found), 3))
    find_peaks(correlation, gain, displacement, ratio, found, place, untilt, np.ones((3, PLAIN + 2)), power)
    assert (power == 1).all()
    return place, untilt


@pytest.mark.parametrize("whitening", [0.0, 0.5, 0.3])
@pytest.mark.parametrize(("axis", "component"), [(2, 0), (1, 1), (0, 2)])
def test_peak_is_where_the_second_window_went(whitening, axis, component):
    rng = np.random.default_rng(5)
    a = rng.random((1, 16, 16, 16)).astype(np.float32)
    b = np.roll(a, 3, axis + 1)
    d, ratio, found = np.zeros((1, 3)), np.zeros(1, np.float32), np.zeros(1, bool)
    correlator = WindowCorrelator((16, 16, 16), (5, 5, 5), whitening=whitening)
    spectra = correlator.spectra(WindowBatch.of(a), WindowBatch.of(b))
    peaks_of(correlator.correlation(spectra), spectra.gain, d, ratio, found)
    expected = np.zeros(3)
    expected[component] = 3
    np.testing.assert_allclose(d[0], expected, atol=0.1)
    assert found[0]
    assert ratio[0] > 3


def test_gaussian_offset_closed_form():
    f = lambda t: np.exp(-((t - 0.3) ** 2) / 2)  # noqa: E731
    assert gaussian_offset(f(-1), f(0), f(1)) == pytest.approx(0.3)
    assert gaussian_offset(-0.1, 1.0, 0.5) == pytest.approx(0.5 * 0.6 / 1.6)  # parabola
    assert gaussian_offset(1.0, 1.0, 1.0) == 0.0


@pytest.mark.parametrize("slant", [0.0, 0.5, 0.8, 0.95, -0.9])
@pytest.mark.parametrize("plane", [(0, 1), (0, 2), (1, 2)])
def test_top_of_a_slanted_peak(plane, slant):
    """A Gaussian whose axes are not the grid's, closed form; sections along the axes alone miss its top."""
    rng = np.random.default_rng(2)
    covariance = np.diag([1.2, 0.9, 2.5])  # x, y, z
    one, other = plane
    covariance[one, other] = covariance[other, one] = slant * np.sqrt(covariance[one, one] * covariance[other, other])
    precision = np.linalg.inv(covariance)
    z, y, x = np.mgrid[-6:7, -6:7, -6:7]
    for top in rng.uniform(-2, 2, (20, 3)):
        d = np.stack([x, y, z], -1) - top
        c = np.exp(-0.5 * np.einsum("...i,ij,...j", d, precision, d))[None]
        got, ratio, found = np.zeros((1, 3)), np.zeros(1, np.float32), np.zeros(1, bool)
        place, untilt = peaks_of(c, ungained(c), got, ratio, found)
        sections = np.linalg.solve(untilt[0], got[0] - place[0])
        if (np.abs(top - place[0]) <= 1.0).all() and (np.abs(sections) < 0.5).all():
            np.testing.assert_allclose(got[0], top, atol=1e-9)
        else:
            assert abs(slant) > 0.7  # on a ridge the highest voxel may lie further off


def test_noise_does_not_make_a_saddle_of_a_peak():
    """Curvatures that no maximum has: the offset stays bounded and finite."""
    c = np.full((1, 3, 3, 3), 0.9)
    c[0, 1, 1, 1] = 1.0
    c[0, 1, 0, 0] = c[0, 1, 2, 2] = 5.0  # but for these two, higher than the middle
    matrix = np.empty((3, 3))
    untilted(c[0], 1, 1, 1, matrix)
    assert np.isfinite(matrix).all()
    eigenvalues = np.linalg.eigvals(np.linalg.inv(matrix))
    assert (eigenvalues.real > 0).all()
    assert np.linalg.det(np.linalg.inv(matrix)) > 0.01  # neither flat nor a ridge along any direction


def test_slanted_peaks_do_not_depend_on_the_unit_of_light():
    """Also where noise leaves a neighbour below zero, of which there is no logarithm."""
    rng = np.random.default_rng(7)
    below = 0
    for _ in range(200):
        c = rng.normal(0.35, 0.25, (3, 3, 3))
        c[1, 1, 1] = 1.0
        below += min(c[1, 1, 0], c[1, 1, 2], c[1, 0, 1], c[1, 2, 1], c[0, 1, 1], c[2, 1, 1]) <= 0.0
        one, other = np.empty((3, 3)), np.empty((3, 3))
        untilted(c, 1, 1, 1, one)
        untilted(1e3 * c, 1, 1, 1, other)
        np.testing.assert_allclose(one, other, rtol=1e-9)
    assert below > 20


def test_second_peak_and_slopes():
    c = np.zeros((3, 3, 3, 21), np.float32)
    c[0, 1, 1, 4], c[0, 1, 1, 15], c[0, 1, 1, 6] = 2.0, 1.0, 1.8  # 6 is the flank of 4
    c[1, 1, 1] = np.arange(21)  # rises beyond the search radius
    c[2] = -1.0
    d, ratio, found = np.zeros((3, 3)), np.zeros(3, np.float32), np.ones(3, bool)
    peaks_of(c, ungained(c), d, ratio, found)
    assert d[0, 0] == pytest.approx(4 - 10)
    assert ratio[0] == pytest.approx(2.0)
    assert found.tolist() == [True, False, False]


def test_peak_is_chosen_without_the_gain_and_placed_with_it():
    """A chance peak far out, higher only after normalisation, does not win; a top that the gain moves is followed."""
    x = np.arange(-10, 11)
    shape = lambda top: np.exp(-0.5 * (x - top) ** 2)  # noqa: E731
    narrow = np.exp(-0.5 * (np.arange(-1, 2)) ** 2)
    c = ((shape(1.3) + 0.7 * shape(-9))[None, None] * narrow[:, None, None] * narrow[:, None])[None].repeat(2, 0)
    gain = np.stack([1 + 0.1 * np.abs(x), np.exp(0.4 * x)])  # the second moves a Gaussian of unit variance by 0.4
    assert (c[0, 1, 1] * gain[0])[1] > (c[0, 1, 1] * gain[0])[11]
    d, ratio, found = np.zeros((2, 3)), np.zeros(2, np.float32), np.ones(2, bool)
    gains = np.ones((1, 3), np.float32), np.ones((1, 3), np.float32), gain.astype(np.float32)
    peaks_of(c.astype(np.float32), gains, d, ratio, found)
    assert d[0, 0] == pytest.approx(1.3, abs=0.1)
    assert d[1, 0] == pytest.approx(1.7, abs=0.01)  # another voxel than the one found first
    np.testing.assert_allclose(d[:, 1:], 0, atol=1e-6)
    np.testing.assert_allclose(ratio, np.exp(-0.5 * 0.3**2) / 0.7, rtol=1e-4)
    assert found.all()


# --- predictor and deformation


def test_spline_is_the_natural_cubic_one_and_straight_beyond():
    rng = np.random.default_rng(1)
    centres = tuple(3.5 + 4.0 * np.arange(n) for n in (3, 4, 6))
    values = rng.standard_normal((3, 3, 4, 6))
    shape = (16, 20, 28)
    spline = fit_spline(values, centres, shape)
    expected = values
    for axis, knots in enumerate(centres, 1):
        at = np.arange(shape[axis - 1])
        s = CubicSpline(knots, expected, axis=axis, bc_type="natural")
        inside = s(np.clip(at, knots[0], knots[-1]))
        beyond = (at - np.clip(at, knots[0], knots[-1])).reshape([-1 if k == axis else 1 for k in range(4)])
        expected = inside + beyond * s(np.clip(at, knots[0], knots[-1]), 1)
    np.testing.assert_allclose(spline.at(*(np.arange(n) for n in shape)), expected, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_spline_with_few_vectors_keeps_linear_fields(count):
    centres = (np.array([4.5]), np.array([4.5, 9.5]), 4.5 + 5.0 * np.arange(count))
    values = np.broadcast_to(1.0 + 0.2 * centres[2] - 0.1 * centres[1][:, None], (3, 1, 2, count))
    got = fit_spline(values, centres, (10, 15, 20)).at(np.arange(10), np.arange(15), np.arange(20))
    x = np.arange(20) if count > 1 else np.full(20, 4.5)
    np.testing.assert_allclose(got, np.broadcast_to(1 + 0.2 * x - 0.1 * np.arange(15)[:, None], got.shape), atol=1e-5)


def test_predictor_filter_keeps_lines_and_removes_zigzag():
    z, y, x = np.meshgrid(*(np.arange(n, dtype=float) for n in (5, 6, 7)), indexing="ij")
    line = np.stack([z + 2 * y, x - y, 3 + z])
    np.testing.assert_allclose(smooth_predictor(line, 0.5), line, atol=1e-12)
    zigzag = np.stack([(-1.0) ** x] * 3)
    assert np.abs(smooth_predictor(zigzag, 0.5)[..., 2:-2]).max() < 1e-12
    wave = np.broadcast_to(np.cos(2 * np.pi * np.arange(48) / 6), (3, 1, 1, 48))  # three windows at 50 % overlap
    np.testing.assert_allclose(smooth_predictor(wave, 0.5)[..., 2:-2], 0.9375 * wave[..., 2:-2], atol=1e-12)


def naive_sample(values, x, y, z):
    """Cubic B-spline blend of all voxels within reach, zero outside."""
    beta = lambda t: 2 / 3 - t**2 + abs(t) ** 3 / 2 if abs(t) < 1 else max(2 - abs(t), 0.0) ** 3 / 6  # noqa: E731
    total = 0.0
    for k, j, i in np.argwhere(values):
        if max(abs(x - i), abs(y - j), abs(z - k)) < 2:
            total += values[k, j, i] * beta(x - i) * beta(y - j) * beta(z - k)
    return total


@pytest.mark.parametrize("share", [-0.5, 0.5])
@pytest.mark.parametrize(
    ("shape", "lit", "far"), [((9, 8, 10), 1.0, 4.0), ((7, 6, 85), 0.02, 4.0), ((7, 6, 85), 0.02, 0.4)]
)
def test_deformed_planes_are_the_naive_blend(share, shape, lit, far):
    rng = np.random.default_rng(2)
    values = np.where(rng.random(shape) < lit, rng.random(shape), 0).astype(np.float32)
    values[-1, -1, -1] = values[0, 0, 0] = values[-1, 0, -1] = 1  # the source's ends
    centres = tuple(2.0 + 3.0 * np.arange(n) for n in (3, 2, shape[2] // 3))
    spline = fit_spline(far * rng.standard_normal((3, *map(len, centres))), centres, shape)
    d = share * spline.at(*(np.arange(n) for n in shape))
    volume = DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, shape), values)
    for lo, hi in (2, 6), (0, 1), (shape[0] - 1, shape[0]):
        got = DeformedPlanes(volume, spline, share).slab(lo, hi)
        for k, j, i in np.ndindex(*got.shape):
            dx, dy, dz = d[:, k + lo, j, i]
            assert got[k, j, i] == pytest.approx(naive_sample(values, i + dx, j + dy, k + lo + dz), abs=2e-5)


def test_deformation_skips_only_what_is_empty():
    """A single voxel anywhere about the borders of blocks of samples: its light arrives whole."""
    shape, centres = (6, 6, 67), (np.array([1.0, 4.0]),) * 2 + (np.array([10.0, 50.0]),)
    for moved in (0.0, 0.3, 7.6, -15.7):
        spline = fit_spline(np.full((3, 2, 2, 2), moved) * np.array([1, 0, 0])[:, None, None, None], centres, shape)
        for x in range(20, 50):
            values = np.zeros(shape, np.float32)
            values[3, 2, x] = 1
            got = DeformedPlanes(DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, shape), values), spline, 0.5).slab(0, 6)
            assert got.sum() == pytest.approx(1, abs=1e-6)
            assert (got.sum((0, 1)) @ np.arange(67)) == pytest.approx(x - 0.5 * moved, abs=1e-4)


def test_rows_without_a_window_are_left_out():
    """Those of windows are as ever, the others hold nothing."""
    shape, rng = (12, 40, 30), np.random.default_rng(4)
    volume = DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, shape), rng.random(shape).astype(np.float32))
    windows = WindowGrid((6, 8, 10), (6, 16, 10), (np.array([0, 6]), np.array([3, 19]), np.array([0, 10, 20])))
    rows = windows.rows(40)
    assert np.flatnonzero(rows).tolist() == [*range(3, 11), *range(19, 27)]
    spline = fit_spline(rng.standard_normal((3, *windows.shape)), windows.centres, shape)
    whole, some = (DeformedPlanes(volume, spline, 0.5, asked).slab(2, 7) for asked in (None, rows))
    np.testing.assert_array_equal(some[:, rows], whole[:, rows])
    assert not some[:, ~rows].any()


# --- validation


def naive_residual(field, believed, floor):
    """The definition, one vector at a time."""
    _, *shape = field.shape
    out = np.full(shape, np.inf)
    for at in np.ndindex(*shape):
        near = {}
        for step in np.ndindex(3, 3, 3):
            offset = tuple(s - 1 for s in step)
            there = tuple(a + o for a, o in zip(at, offset, strict=True))
            if offset != (0, 0, 0) and all(0 <= t < n for t, n in zip(there, shape, strict=True)) and believed[there]:
                near[offset] = field[(slice(None), *there)]
        if len(near) < 4:
            continue
        carried = {o: d.copy() for o, d in near.items()}
        for axis in range(3):
            for side in (-1, 1):
                steps = []
                for o, d in near.items():
                    inner = tuple(0 if k == axis else v for k, v in enumerate(o))
                    if o[axis] == side and inner in near:
                        steps.append(d - near[inner])
                if steps:
                    step = np.median(steps, axis=0)
                    for o in carried:
                        if o[axis] == side:
                            carried[o] = carried[o] - step
        values = np.array(list(carried.values()))
        median = np.median(values, axis=0)
        spread = np.median(np.abs(values - median), axis=0)
        out[at] = (np.abs(field[(slice(None), *at)] - median) / (spread + floor)).max()
    return out


def test_normalised_median_is_its_definition():
    rng = np.random.default_rng(4)
    field = rng.standard_normal((3, 4, 5, 4))
    believed = rng.random((4, 5, 4)) > 0.3
    np.testing.assert_allclose(normalised_median(field, believed, 0.1), naive_residual(field, believed, 0.1), rtol=1e-9)


@pytest.mark.parametrize("layers", [1, 2, 3])
def test_a_few_layers_at_a_time_are_judged_as_all_are(monkeypatch, layers):
    rng = np.random.default_rng(5)
    field, believed = rng.normal(size=(3, 7, 4, 5)), rng.random((7, 4, 5)) > 0.1
    whole = normalised_median(field, believed, 0.1)
    monkeypatch.setattr(validation, "_AT_A_TIME", layers * 20)
    np.testing.assert_array_equal(normalised_median(field, believed, 0.1), whole)


def test_four_vectors_cannot_condemn_one_another():
    field = np.zeros((3, 1, 2, 2))
    field[0, 0] = [[5.37, 5.08], [5.08, 5.46]]  # no shear, but three carried neighbours would agree on 4.7
    everywhere = np.ones((1, 2, 2), bool)
    assert not find_outliers(field, everywhere, 3.0, 0.1).any()


def test_outliers_among_outliers_are_not_taken_back():
    """Once their neighbours are rejected too, nothing is left to test them by: that does not acquit them."""
    shape = (8, 16, 16)
    rng = np.random.default_rng(1)
    field = 0.05 * rng.standard_normal((3, *shape))
    wrong = np.zeros(shape, bool)
    wrong[2:6, 4:10, 4:10] = True
    field[:, wrong] = rng.uniform(-15, 15, (3, wrong.sum()))
    outlier = find_outliers(field, np.ones(shape, bool), 3.0, 0.1)
    assert outlier[wrong].mean() > 0.96  # 0.8 with those that were taken back
    assert not outlier[~wrong].any()


def linear_field(shape):
    z, y, x = np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij")
    return np.stack([1.4 * z + 0.2 * x, -0.5 * y + 0.3 * z, 2 - 0.6 * x])


def test_shear_and_crests_are_no_outliers_but_outliers_are():
    shape = (8, 9, 10)
    y = np.arange(9)[:, None]
    rng = np.random.default_rng(6)
    field = linear_field(shape) + 2 * np.sin(2 * np.pi * y / 6) + 0.05 * rng.standard_normal((3, *shape))
    wrong = rng.random(shape) < 0.08
    wrong[0, 0, 0] = wrong[3, 4, 5] = True
    everywhere = np.ones(shape, bool)
    assert find_outliers(field, everywhere, 3.0, 0.1).mean() < 0.01
    field[:, wrong] += rng.choice([-1, 1], (3, wrong.sum())) * rng.uniform(3, 10, (3, wrong.sum()))
    outlier = find_outliers(field, everywhere, 3.0, 0.1)
    assert outlier[wrong].mean() > 0.95
    assert outlier[~wrong].mean() < 0.05


@pytest.mark.parametrize("noise", [0.03, 0.1])
def test_default_validation_finds_what_is_wrong_and_leaves_the_rest(noise):
    """Vectors of normal noise (voxels, each component), of which a few are off by 0.4 voxel and six standard deviations
    along one axis: nine of ten are found. Of good ones no more than one in fifty is condemned."""
    settings = CorrelationSettings()
    rng = np.random.default_rng(8)
    shape = (12, 12, 12)
    field = linear_field(shape) + noise * rng.standard_normal((3, *shape))
    everywhere = np.ones(shape, bool)

    def found(vectors):
        return find_outliers(vectors, everywhere, settings.outlier_threshold, settings.outlier_floor_voxels)

    assert found(field).mean() < 0.02
    wrong = np.zeros(shape, bool)
    wrong[1::3, 1::3, 1::3] = True  # none beside another
    off = np.eye(3)[rng.integers(0, 3, wrong.sum())].T * (0.4 + 6 * noise)
    field[:, wrong] += off * rng.choice([-1, 1], wrong.sum())
    assert found(field)[wrong].mean() > 0.9
    assert found(field)[~wrong].mean() < 0.02


def test_replacement_of_a_linear_field_is_exact_even_for_a_corner():
    truth = linear_field((5, 6, 7))
    valid = np.random.default_rng(7).random((5, 6, 7)) > 0.3
    valid[:2, :2, :3] = False
    valid[4] = False
    damaged = np.where(valid, truth, 99.0)
    np.testing.assert_allclose(replace_invalid(damaged, valid), truth, atol=1e-9)


def test_replacement_from_one_vector_and_from_none():
    field, valid = np.zeros((3, 2, 3, 4)), np.zeros((2, 3, 4), bool)
    field[:, 1, 1, 1], valid[1, 1, 1] = (1, 2, 3), True
    np.testing.assert_allclose(replace_invalid(field, valid), np.reshape([1, 2, 3], (3, 1, 1, 1)) + field * 0)
    with pytest.raises(PlenoPIVError, match=r"correlation\.windows"):
        replace_invalid(field, np.zeros_like(valid))
