"""Statistics in a stream against NumPy over all fields at once."""

import numpy as np
import pytest
import xarray as xr

from plenopiv.errors import PlenoPIVError
from plenopiv.statistics import SeriesStatistics, summary_of
from plenopiv.statistics.variables import INTERVAL

STRESS = np.array([[1.0, -0.35, 0.1], [-0.35, 0.6, 0.05], [0.1, 0.05, 0.4]])


def collected(fields, **options):
    statistics = SeriesStatistics(fields[0], **options)
    for field in fields:
        statistics.add(field)
    return statistics.result()


@pytest.fixture
def values():
    """(time, 3, z, y, x): skewed, correlated components about a mean of a thousand RMS."""
    rng = np.random.default_rng(5)
    white = rng.gamma(2.0, size=(40, 3, 3, 4, 5))
    return 1000.0 + np.einsum("ij,tj...->ti...", np.linalg.cholesky(STRESS), white)


def test_what_tracks_do_not_resolve_is_not_taken_off(values, field_of):
    fields = [field_of(v, 0.2) for v in values[:6]]
    windows = collected(fields)
    for field in fields:
        field.attrs["divergence_free"] = 1
    tracks = collected(fields)
    xr.testing.assert_equal(tracks.uu, windows.uu)
    xr.testing.assert_equal(tracks.uv_std, windows.uv_std)
    for name in ("uu_noise", "uu_corrected", "uu_corrected_std", "u_rms_corrected", "u_mean_std_measurement"):
        assert tracks[name].isnull().all()
        assert windows[name].notnull().all()
    assert summary_of(tracks)["median_noise_share"] == [None] * 3


def test_vectors_without_an_error_bar_are_none_without_noise(values, field_of):
    std = np.full(values.shape[1:], 0.5)
    fields = [field_of(v, np.where(k % 2, np.nan, std)) for k, v in enumerate(values[:8])]
    assert collected(fields).uu_noise.values == pytest.approx(0.25)


def test_moments_are_those_of_all_samples_together(values, field_of):
    rng = np.random.default_rng(6)
    valid = rng.random((40, 3, 4, 5)) > 0.2
    std = rng.uniform(0.1, 0.3, values.shape)
    found = collected([field_of(v, s, ok) for v, s, ok in zip(values, std, valid, strict=True)])
    masked = np.where(valid[:, None], values, np.nan)
    mean = np.nanmean(masked, 0)
    off = masked - mean
    n = valid.sum(0)
    assert (found.samples == n).all()
    for c, name in enumerate("uvw"):
        close = {"rtol": 1e-9, "atol": 1e-12}
        np.testing.assert_allclose(found[f"{name}_mean"], mean[c], rtol=1e-13)
        np.testing.assert_allclose(found[f"{name}_rms"], np.nanstd(masked[:, c], 0, ddof=1), **close)
        second = np.nanmean(off[:, c] ** 2, 0)
        np.testing.assert_allclose(found[f"{name}_skewness"], np.nanmean(off[:, c] ** 3, 0) / second**1.5, **close)
        noise = np.nanmean(np.where(valid, std[:, c] ** 2, np.nan), 0)
        np.testing.assert_allclose(found[f"{name * 2}_noise"], noise, **close)
        np.testing.assert_allclose(found[f"{name * 2}_corrected"], found[name * 2] - noise, **close)
        np.testing.assert_allclose(found[f"{name}_mean_std_measurement"], np.sqrt(noise / n), **close)
        for d in range(c, 3):
            covariance = np.nansum(off[:, c] * off[:, d], 0) / (n - 1)
            np.testing.assert_allclose(found[name + "uvw"[d]], covariance, **close)


def test_uncertainties_without_correlation_are_the_scatter_over_the_root_of_n(values, field_of):
    """By the definition: the scatter of products of fluctuations, and of what each sample adds to skewness."""
    found = collected([field_of(v) for v in values], lags=0)
    off = values - values.mean(0)
    n = len(values)
    np.testing.assert_allclose(found.u_mean_std, values[:, 0].std(0, ddof=1) / np.sqrt(n), rtol=1e-9)
    for name, (a, b) in {"uu": (0, 0), "uv": (0, 1), "uw": (0, 2), "vw": (1, 2), "ww": (2, 2)}.items():
        np.testing.assert_allclose(found[f"{name}_std"], (off[:, a] * off[:, b]).std(0) / np.sqrt(n - 3), rtol=1e-7)
    np.testing.assert_allclose(found.w_rms_std, found.ww_std / (2 * found.w_rms))

    def skewness(weights):
        mean = np.tensordot(weights, values[:, 1], 1)
        second, third = (np.tensordot(weights, (values[:, 1] - mean) ** p, 1) for p in (2, 3))
        return third / second**1.5

    equal, step = np.full(n, 1 / n), 1e-5
    influence = [(skewness(equal + step * (one - equal)) - skewness(equal)) / step for one in np.eye(n)]
    np.testing.assert_allclose(found.v_skewness_std, np.sqrt(np.mean(np.square(influence), 0) / n), rtol=1e-3)


@pytest.mark.parametrize("component", range(3))
def test_a_component_is_not_another(component, field_of):
    """Only one component changes, upward in most fields: its mean, RMS and skewness alone."""
    fields = []
    for k in range(8):
        values = np.zeros((3, 2, 2, 2))
        values[component] = 7.0 if k == 0 else 1.0
        fields.append(field_of(values))
    found = collected(fields)
    for c, name in enumerate("uvw"):
        mine = c == component
        np.testing.assert_allclose(found[f"{name}_mean"], 1.75 if mine else 0.0)
        np.testing.assert_allclose(found[name * 2], 4.5 if mine else 0.0)
        assert ((found[f"{name}_skewness"] > 1) == mine).all()
    for name in ("uv", "uw", "vw"):
        np.testing.assert_allclose(found[name], 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("a", "b"), [(0, 1), (0, 2), (1, 2)])
def test_the_sign_of_a_shear_stress(a, b, sign, field_of):
    fields = []
    for k in range(6):
        values = np.zeros((3, 2, 2, 2))
        values[a], values[b] = (-1.0) ** k, sign * (-1.0) ** k
        fields.append(field_of(values))
    found = collected(fields)
    for name in ("uv", "uw", "vw"):
        np.testing.assert_allclose(found[name], sign * 6 / 5 if name == "uvw"[a] + "uvw"[b] else 0.0)


def test_axes_keep_their_order(field_of):
    """A field given as (x, y, z) is the same field."""
    values = np.random.default_rng(1).normal(size=(5, 3, 2, 3, 4))
    fields = [field_of(v) for v in values]
    turned = [field.transpose("x", "y", "z") for field in fields]
    xr.testing.assert_identical(collected(fields), collected(turned))


def test_which_vectors_count(field_of):
    values = np.random.default_rng(2).normal(size=(4, 3, 2, 2, 3))
    valid, inside = np.ones((2, 2, 3), bool), np.zeros((2, 2, 3), bool)
    valid[0, 0, 0] = valid[1, 1, 1] = False  # replaced; in a body
    inside[1, 1, 1] = True
    values[:, :, 1, 1, 1] = np.nan
    fields = [field_of(v, 0.1, valid, inside, time=k) for k, v in enumerate(values)]
    fields[2] = field_of(np.full((3, 2, 2, 3), np.nan), np.nan, np.zeros((2, 2, 3)), inside, time=2)  # set aside
    found, with_replaced = collected(fields), collected(fields, replaced=True)
    assert found.attrs["pairs"] == 4
    assert found.attrs["pairs_left_out"] == 1
    assert found.samples.values[0, 0].tolist() == [0, 3, 3]
    assert with_replaced.samples.values[0, 0].tolist() == [3, 3, 3]
    assert found.samples.values[1, 1].tolist() == with_replaced.samples.values[1, 1].tolist() == [3, 0, 3]
    for name in ("u_mean", "v_rms", "ww", "uv_std", "u_independent_samples", "w_skewness"):
        assert np.isnan(found[name].values[1, 1, 1]) or name == "u_independent_samples"
        assert np.isfinite(found[name].values[0, 1]).all()


def test_the_same_fields_give_the_same_bits_and_memory_does_not_grow(field_of):
    rng = np.random.default_rng(4)
    fields = [field_of(rng.normal(size=(3, 2, 3, 4)), 0.1, rng.random((2, 3, 4)) > 0.1) for _ in range(30)]
    xr.testing.assert_identical(collected(fields), collected(fields))

    def held(thing):
        inside = list(thing.values()) if isinstance(thing, dict) else list(vars(thing).values())
        return sum(
            value.nbytes if isinstance(value, np.ndarray) else held(value)
            for value in inside
            if isinstance(value, np.ndarray | dict)
        )

    statistics = SeriesStatistics(fields[0])
    sizes = []
    for k in range(60):
        statistics.add(fields[k % 30])
        sizes.append(held(statistics.moments) + held(statistics.time))
    assert len(set(sizes)) == 1


def test_convergence_is_followed_at_a_few_places(field_of):
    values = np.random.default_rng(8).normal(3.0, 1.0, size=(150, 3, 3, 4, 5))
    valid = np.ones((3, 4, 5), bool)
    valid[1, 2, 2] = False
    found = collected([field_of(v, valid=valid) for v in values])
    assert found.sizes["running"] <= 129
    numbers = found.running_pairs.values
    assert numbers[-1] == 150
    assert (np.diff(numbers) > 0).all()
    for place in range(found.sizes["place"]):
        z, y, x = (int(np.argmin(np.abs(found[a].values - float(found[f"place_{a}"][place])))) for a in "zyx")
        assert valid[z, y, x]
        for c, name in enumerate("uvw"):
            at = {"running": 20, "place": place, "component": c}
            so_far = values[: numbers[20], c, z, y, x]
            assert float(found.running_mean[at]) == pytest.approx(so_far.mean())
            assert float(found.running_rms[at]) == pytest.approx(so_far.std(ddof=1))
            last = found.isel(running=-1, place=place, component=c)
            here = found.isel(z=z, y=y, x=x)
            for one, other in (("mean", "mean"), ("rms", "rms"), ("mean_std", "mean_std"), ("rms_std", "rms_std")):
                assert float(last[f"running_{one}"]) == pytest.approx(float(here[f"{name}_{other}"]), rel=1e-6)


def test_two_vectors_tell_no_error_of_a_stress(field_of):
    """Their products of fluctuations are equal: 0 would be said however far off the stress is."""
    fields = [field_of(v, 0.1) for v in np.random.default_rng(1).normal(size=(3, 3, 2, 2, 2))]
    two, three = collected(fields[:2]), collected(fields)
    for name in ("u_rms", "uu", "vw", "ww_corrected", "v_rms_corrected", "w_skewness"):
        assert np.isnan(two[f"{name}_std"]).all(), name
        assert (three[f"{name}_std"] > 0).all(), name
    assert (two.u_mean_std > 0).all()
    assert np.isfinite(two.uu).all()
    assert np.isfinite(three.running_mean_std[:, 0, 0]).values.tolist() == [False, True, True]
    assert np.isfinite(three.running_rms_std[:, 0, 0]).values.tolist() == [False, False, True]
    assert summary_of(two)["median_rms_std_m_s"] == [None] * 3
    assert all(summary_of(two)["median_mean_std_m_s"])


def test_every_variable_says_what_it_is(field_of):
    found = collected([field_of(v) for v in np.random.default_rng(0).normal(size=(4, 3, 2, 2, 2))])
    for name, variable in found.data_vars.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
        for other in variable.attrs.get("ancillary_variables", "").split():
            assert other in found, name
    texts = [variable.attrs["long_name"] for name, variable in found.data_vars.items()]
    assert len(set(texts)) == len(texts)
    assert "share of the random errors of vectors" in found.u_mean_std_measurement.attrs["long_name"]
    assert str(INTERVAL) in found.u_mean_std.attrs["comment"]


def test_a_summary_is_plain_numbers(field_of):
    values = np.zeros((6, 3, 2, 3, 4))
    values[::2, 1, 1, 2, 3] = 2.0
    told = summary_of(collected([field_of(v, 0.01) for v in values]))
    assert told["largest_rms_m_s"] == pytest.approx([0.0, np.sqrt(1.2), 0.0])
    assert told["largest_rms_at_mm"][1] == [0.5, 0.0, -0.5]
    assert told["pairs"] == 6
    nothing = summary_of(collected([field_of(np.full((3, 2, 2, 2), np.nan))]))
    assert nothing["largest_rms_m_s"] == [None] * 3
    assert nothing["pairs_left_out"] == 1


def test_fields_that_do_not_fit(field_of):
    one = field_of(np.zeros((3, 2, 2, 2)))
    statistics = SeriesStatistics(one)
    with pytest.raises(PlenoPIVError, match="other coordinates y"):
        statistics.add(one.assign_coords(y=one.y + 0.1))
    with pytest.raises(PlenoPIVError, match="2 times at once"):
        statistics.add(xr.concat([one, one], "time"))
    with pytest.raises(PlenoPIVError, match="without w_std"):
        statistics.add(one.drop_vars("w_std"))
    with pytest.raises(PlenoPIVError, match="lags"):
        SeriesStatistics(one, lags=-1)
