"""The field of scattered tracks: its smoothing, its divergence, its error bars."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flows import flow
from plenopiv.tracking import splines
from plenopiv.tracking.field import field_from_tracks
from plenopiv.tracking.parts import field_on_grid

LIMITS = ((-1.0, 1.0), (-1.0, 1.0), (-0.8, 0.8))
FLOW = flow("abc", wavelength_mm=2.4, amplitudes_m_s=(0.1, 0.12, 0.09))
STD = np.array([0.004, 0.004, 0.012])


@pytest.fixture(scope="module")
def tracks():
    rng = np.random.default_rng(2)
    position = rng.uniform(*np.transpose(LIMITS), (900, 3))
    std = np.broadcast_to(STD, position.shape) * rng.uniform(0.5, 2.0, (900, 1))
    velocity = FLOW(position) + std * rng.standard_normal(position.shape)
    velocity[:5] += 0.3  # wrong links
    return position, velocity, std


@pytest.fixture(scope="module")
def fields(tracks):
    return [field_from_tracks(*tracks, LIMITS, 0.4, divergence_free=free) for free in (True, False)]


@pytest.fixture(scope="module")
def places():
    return np.random.default_rng(3).uniform(-0.7, 0.7, (400, 3)) * (1, 1, 0.8)


def test_errors_are_less_than_those_of_tracks_and_least_without_divergence(fields, places):
    free, any_field = ((field.velocity(places)[0] - FLOW(places)) for field in fields)
    rms = np.sqrt((free**2).mean(0))
    assert (rms < 0.6 * STD).all()
    assert np.linalg.norm(rms / STD) < np.linalg.norm(np.sqrt((any_field**2).mean(0)) / STD)


def test_divergence(fields, places):
    free, any_field = (np.einsum("nii->n", field.gradient(places)) for field in fields)
    assert np.sqrt((free**2).mean()) < 0.05 * np.sqrt((any_field**2).mean())


def test_gradients_are_differences(fields, places):
    step = 1e-4
    for axis in range(3):
        move = step * np.eye(3)[axis]
        ahead, behind = (fields[0]._basis(places + s * move) @ fields[0].coefficients[0].T for s in (1, -1))
        assert fields[0].gradient(places)[:, :, axis] == pytest.approx(1e3 * (ahead - behind) / (2 * step), abs=1e-2)


def test_error_bars_cover(fields, places):
    velocity, std = fields[0].velocity(places)
    off = np.abs(velocity - FLOW(places))
    assert 0.5 < (off < std).mean() < 0.85
    assert (off < 2 * std).mean() > 0.85


def test_wrong_links_are_left_out(fields):
    assert not fields[0].used[:5].any()
    assert fields[0].used[5:].mean() > 0.98
    assert fields[0].chi2 == pytest.approx(1.0, abs=0.1)


def test_too_few_tracks():
    with pytest.raises(PlenoPIVError, match=r"10 tracks and nodes 0\.2 mm apart make no field"):
        field_from_tracks(np.zeros((10, 3)), np.zeros((10, 3)), np.ones((10, 3)), LIMITS, 0.2)


@pytest.mark.parametrize("line", [False, True])
@pytest.mark.parametrize("turned", [np.eye(3), np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]])
def test_tracks_in_a_plane_make_no_field_of_a_volume(line, turned):
    """Beyond it errors were 190 times the error bars: of what nothing decides fits know no scatter."""
    position, velocity, std = strip(1.0, 0)
    flat = (position * (0.2, 0.0 if line else 0.5, 0.0)) @ turned
    with pytest.raises(PlenoPIVError, match="120 tracks in a plane or on a line make no field"):
        field_from_tracks(flat, velocity, std, ((-2.0, 2.0),) * 3, 1.0)


def test_a_thin_sheet_has_a_field():
    position, velocity, std = strip(1.0, 0)
    flat = position * (1, 4, 0)
    field_from_tracks(flat, velocity, std, ((0.0, 4.0), (0.0, 4.0), (-0.2, 0.2)), 1.0)
    sheet = flat + np.random.default_rng(0).uniform(-1, 1, flat.shape) * (0, 0, 0.005)
    _, bars = field_from_tracks(sheet, velocity, std, ((0.0, 4.0),) * 3, 1.0).velocity(
        [(2.0, 2.0, 0.0), (2.0, 2.0, 3.0)]
    )
    assert (bars[1] > 100 * bars[0]).all()  # what the sheet does not tell is said


def test_tracks_that_are_not_numbers_are_left_out(tracks, fields, places):
    odd = [np.concatenate([each, each[:9]]) for each in tracks]
    for k, each in enumerate(odd):
        each[900 + 3 * k :, k], each[901 + 3 * k, k] = np.nan, np.inf
    found = field_from_tracks(*odd, LIMITS, 0.4)
    assert (found.used == [*fields[0].used, *[False] * 9]).all()
    for one, other in zip(found.velocity(places), fields[0].velocity(places), strict=True):
        assert (one == other).all()


@pytest.mark.parametrize("wrong", [0.0, -0.002])
def test_an_error_that_is_not_positive_is_named(tracks, wrong):
    position, velocity, std = tracks
    std = std.copy()
    std[7, 1] = wrong
    with pytest.raises(PlenoPIVError, match=f"std_m_s of track 7 is {wrong:g}, a standard deviation is positive"):
        field_from_tracks(position, velocity, std, LIMITS, 0.4)
    with pytest.raises(PlenoPIVError, match="std_m_s of track 7"):
        field_on_grid(position, velocity, std, LIMITS, (np.zeros(1),) * 3)


def test_no_point_has_no_velocity(fields):
    assert [each.shape for each in fields[0].velocity(np.zeros((0, 3)))] == [(0, 3)] * 2
    assert fields[0].gradient(np.zeros((0, 3))).shape == (0, 3, 3)


def test_tracks_that_are_known_well_do_not_stand_for_flow_that_is_not_resolved():
    """Eddies of all sizes, and a layer in which tracks are known a hundredth as well, as near focus. With weights by
    the tracks' errors alone the others bend the splines there, and the layer is .044 wrong."""
    rng = np.random.default_rng(1)
    waves = np.geomspace(0.4, 3.0, 60)
    k = rng.standard_normal((60, 3))
    k *= (2 * np.pi / waves / np.linalg.norm(k, axis=1))[:, None]
    amplitude = np.cross(k, rng.standard_normal((60, 3)))
    amplitude *= (0.03 * waves ** (1 / 3) / np.linalg.norm(amplitude, axis=1))[:, None]
    phase = rng.uniform(0.0, 2 * np.pi, 60)

    def flow(at):
        return np.sin(at @ k.T + phase) @ amplitude

    position = rng.uniform(-1.0, 1.0, (1500, 3))
    layer = np.abs(position[:, 2]) < 0.15
    std = np.where(layer, 0.05, 0.0005)[:, None] * np.ones(3)
    velocity = flow(position) + std * rng.standard_normal(position.shape)
    field = field_from_tracks(position, velocity, std, ((-1.0, 1.0),) * 3, 0.33)
    places = rng.uniform(-0.8, 0.8, (1500, 3))
    found, bars = field.velocity(places)
    off, within = np.abs(found - flow(places)), np.abs(places[:, 2]) < 0.15
    assert (np.sqrt((off[within] ** 2).mean(0)) < 0.033).all()
    assert (np.sqrt((off[~within] ** 2).mean(0)) < 0.016).all()
    assert ((off < bars).mean(0) > 0.65).all()
    assert ((off < 2 * bars).mean(0) > 0.88).all()
    assert field.scale < 1.3


def test_error_bars_know_what_nodes_do_not_resolve():
    """A wave of two and a half nodes on one side of the volume, none on the other."""
    rng = np.random.default_rng(6)
    position = rng.uniform(-1.0, 1.0, (1500, 3))
    std = np.full(position.shape, 0.002)
    limits = ((-1.0, 1.0),) * 3

    def flow(at):
        bends = np.where(at[:, 0] > 0.0, np.sin(2 * np.pi * at[:, 1] / 0.8), 0.0) * np.abs(at[:, 0])
        return np.stack([0 * bends, 0 * bends, 0.1 * bends], -1)

    velocity = flow(position) + std * rng.standard_normal(position.shape)
    field = field_from_tracks(position, velocity, std, limits, 0.33)
    places = rng.uniform(-0.8, 0.8, (800, 3))
    found, bars = field.velocity(places)
    off, bends = np.abs(found - flow(places))[:, 2], places[:, 0] > 0.3
    assert field.used[position[:, 0] > 0.3].all()  # what is missed where all are missed is no wrong link
    assert 0.7 < np.sqrt((bars[bends, 2] ** 2).mean() / (off[bends] ** 2).mean()) < 1.3
    assert (off < 2 * bars[:, 2])[bends].mean() > 0.85
    even = places[:, 0] < -0.3
    assert bars[even, 2].mean() < 0.5 * bars[bends, 2].mean()
    scatter = np.stack([field._basis(places) @ each.T for each in field.coefficients[1:]]).std(0)
    assert (off < 2 * scatter[:, 2])[bends].mean() < (off < 2 * bars[:, 2])[bends].mean()


def test_error_bars_cover_what_chance_adds():
    """Flow that splines follow, tracks of unequal errors: here and there noise passes for flow finer than nodes."""
    off, bars, added = [], [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        position, places = rng.uniform(-1.0, 1.0, (900, 3)), rng.uniform(-0.9, 0.9, (600, 3))
        std = 0.01 * np.exp(0.8 * rng.standard_normal((900, 1))) * np.ones(3)

        def flow(at):
            return np.stack([0.2 * at[:, 1], -0.3 * at[:, 0], 0.1 * np.ones(len(at))], -1)

        velocity = flow(position) + std * rng.standard_normal(position.shape)
        field = field_from_tracks(position, velocity, std, ((-1.0, 1.0),) * 3, 0.33)
        found, bar = field.velocity(places)
        off.append(np.abs(found - flow(places)))
        bars.append(bar)
        added.append(field.remainder.at(places)[0] != 0.0)
    off, bars, added = (np.concatenate(each) for each in (off, bars, added))
    fits = np.stack([field._basis(places) @ each.T for each in field.coefficients[1:]])
    _, chance, untold = field.remainder.at(places)
    finer = untold * field.unresolved.at(places, chance / untold)
    assert bar == pytest.approx(np.sqrt(fits.var(0) * len(fits) / (len(fits) - 1) + finer))
    assert 0.05 < added.mean() < 0.3
    assert (off < 2 * bars)[added].mean() > 0.93
    assert 0.62 < (off < bars).mean() < 0.78
    assert (off < 2 * bars).mean() > 0.93


def strip(width, seed):
    """Tracks in one corner, uniform flow."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, 1, (120, 3)) * (4.0, width, 0.2)
    std = np.full(position.shape, 0.01)
    return position, np.array([0.3, 0.1, -0.2]) + std * rng.standard_normal(position.shape), std


@pytest.mark.parametrize("along", [1.0, 0.05])
@pytest.mark.parametrize("seed", range(2))
def test_tracks_in_a_corner_make_a_field(seed, along):
    """However smooth it may be: where no track is, little holds the coefficients."""
    position, velocity, std = strip(1.0, seed)
    position = position * (along, 1, 1)
    field = field_from_tracks(position, velocity, std, ((0.0, 4.0),) * 3, 1.0)
    assert np.sqrt(np.mean((field.velocity(position)[0] - (0.3, 0.1, -0.2)) ** 2)) < 0.01  # of one track


def test_coefficients_that_rounding_hides_are_said(monkeypatch):
    monkeypatch.setattr(splines, "RIDGE", -1.0)
    with pytest.raises(PlenoPIVError, match="in a part of the volume alone make no field"):
        field_from_tracks(*strip(1.0, 0), ((0.0, 4.0),) * 3, 1.0)
