"""Error bars of derivatives against many noisy fields, and against the covariance written out."""

import numpy as np
import pytest

from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.statistics import gradients, velocity_gradients
from plenopiv.statistics.gradients import neighbour_correlation
from plenopiv.velocity import q_criterion, velocity_gradient, vorticity

SHAPE = (5, 4, 6)
APART = CorrelationSettings(windows=((32, 32, 32),), inner_window=(32, 32, 32), overlap=0.0)
OVERLAPPING = CorrelationSettings(windows=((32, 32, 32),), inner_window=(32, 32, 32), overlap=0.5)


def flow(field_of, seed=0):
    rng = np.random.default_rng(seed)
    return field_of(rng.normal(size=(3, *SHAPE)), rng.uniform(0.1, 0.3, (3, *SHAPE)))


def test_values_are_those_of_the_plain_functions(field_of):
    field = flow(field_of)
    found, g = velocity_gradients(field), velocity_gradient(field)
    for i, name in enumerate("uvw"):
        for j, axis in enumerate("xyz"):
            np.testing.assert_array_equal(found[f"d{name}_d{axis}"], g[i, j])
    for k, axis in enumerate("xyz"):
        np.testing.assert_array_equal(found[f"vorticity_{axis}"], vorticity(g)[k])
    np.testing.assert_array_equal(found.q, q_criterion(g))
    np.testing.assert_allclose(found.divergence, g[0, 0] + g[1, 1] + g[2, 2])
    for name in found:
        assert found[name].attrs["units"] == ("s-2" if name.startswith("q") else "s-1")
        assert np.isfinite(found[name]).all()


def test_a_field_without_error_bars_has_derivatives_without(field_of):
    field = flow(field_of)
    found = velocity_gradients(field[["u", "v", "w"]])
    assert not [name for name in found if name.endswith("_std")]
    np.testing.assert_array_equal(found.dw_dx, velocity_gradients(field).dw_dx)
    assert "ancillary_variables" not in found.q.attrs


def test_error_bars_are_the_scatter_over_noisy_fields(field_of, monkeypatch):
    """Noise with the stated standard deviations and a correlation of 0.5 and 0.2 along every axis."""
    rho = np.array([1.0, 0.5, 0.2])
    monkeypatch.setattr(gradients, "neighbour_correlation", lambda settings: np.tile(rho, (3, 1)))
    field, rng = flow(field_of), np.random.default_rng(1)
    field = field.assign({n: 40 * field[n] for n in "uvw"})  # so that Q is nearly linear in the noise
    std = np.stack([field[f"{n}_std"].values for n in "uvw"])
    roots = []
    for n in SHAPE:  # separable: along each axis alone it is rho
        apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        roots.append(np.linalg.cholesky(np.where(apart < 3, rho[np.minimum(apart, 2)], 0.0)))
    sums = {}
    count = 150
    for _ in range(count):
        noise = std * np.einsum("za,yb,xc,nabc->nzyx", *roots, rng.normal(size=(3, *SHAPE)), optimize=True)
        g = velocity_gradient(field.assign({n: field[n] + noise[k] for k, n in enumerate("uvw")}))
        values = {
            "vorticity_x": g[2, 1] - g[1, 2],
            "vorticity_y": g[0, 2] - g[2, 0],
            "vorticity_z": g[1, 0] - g[0, 1],
            "divergence": g[0, 0] + g[1, 1] + g[2, 2],
            "q": q_criterion(g),
            **{f"d{'uvw'[i]}_d{'xyz'[j]}": g[i, j] for i in range(3) for j in range(3)},
        }
        for name, value in values.items():
            sums.setdefault(name, []).append(value)
    found = velocity_gradients(field)
    inside = (slice(1, -1),) * 3
    for name, values in sums.items():
        ratio = found[f"{name}_std"].values / np.std(values, 0)
        # at the faces one-sided differences along two axes share a vector
        assert np.median(ratio[inside]) == pytest.approx(1.0, abs=0.05), name
        if name.startswith("d") and name != "divergence":
            assert np.median(ratio) == pytest.approx(1.0, abs=0.05), name


def test_correlation_of_neighbours_is_that_of_windows_which_overlap():
    """Windows that touch share nothing but taper and deformation; those that overlap by half share half a window; those
    of three quarters more, and less the farther apart."""
    touching, half = neighbour_correlation(APART), neighbour_correlation(OVERLAPPING)
    np.testing.assert_allclose(touching[:, 0], 1.0)
    assert np.abs(touching[:, 1:]).max() < 0.2
    assert ((half[:, 1] > 0.4) & (half[:, 1] < 0.55)).all()
    assert np.abs(half[:, 2]).max() < 0.1
    sub_windows = neighbour_correlation(CorrelationSettings())
    np.testing.assert_allclose(sub_windows[0], [1.0, 0.575, 0.077], atol=0.01)
    assert (sub_windows[:, 1] > half[:, 1]).all()


def test_axes_have_the_correlation_of_their_own_windows():
    """Sub-windows make neighbours alike along the axis along which there are some."""
    found = neighbour_correlation(CorrelationSettings(windows=((32, 32, 32),), inner_window=(32, 32, 16)))
    assert found[2, 1] != pytest.approx(found[1, 1], abs=0.02)
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)


def test_unknown_vectors_and_single_planes(field_of):
    field = flow(field_of).copy(deep=True)
    for name in ("u", "v", "w", "u_std", "v_std", "w_std"):
        field[name][2, 1, 3] = np.nan
    found = velocity_gradients(field)
    assert np.argwhere(np.isnan(found.du_dx.values)).tolist() == [[2, 1, 2], [2, 1, 3], [2, 1, 4], [2, 1, 5]]
    assert np.isnan(found.du_dz.values[2, 1, 3])  # though it has neighbours on both sides
    for name in ("du_dx", "du_dz", "vorticity_y", "q"):
        np.testing.assert_array_equal(np.isnan(found[name]), np.isnan(found[f"{name}_std"]))
    with pytest.raises(PlenoPIVError, match="one vector along z"):
        velocity_gradients(field.isel(z=[0]))
