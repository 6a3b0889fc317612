"""Shifts of mean micro-images, however they are lit within."""

import numpy as np
import pytest
from scipy.special import erfc

from plenopiv.calibration.mean_micro_images import LIGHT_POWERS, TERMS, region_shifts, terms_of
from plenopiv.calibration.micro_images import Disc, inside
from plenopiv.calibration.spectrum import unit_centres

DISC = Disc("hexagonal", 14.04 * np.exp(0.01j), 6.9, 0.4)
SHAPE = (200, 230)
RAYS = 8  # of a pixel, along each axis


def lattice():
    """Centres of micro-images, px from the axis, and numbers of lenses."""
    i, j = (each.ravel() for each in np.meshgrid(np.arange(-14, 15), np.arange(-14, 15)))
    numbers = unit_centres("hexagonal", i, j)
    return 0.3 - 0.2j + DISC.pitch * numbers, numbers


def drawn(shift, light):
    """An image (t, s) of blurred discs by many rays for each pixel, each lit by ``light`` (u, v, number), u and v px
    from its middle, shifted from the lattice by ``shift``."""
    rows, columns = SHAPE
    image, step = np.zeros((rows * RAYS, columns * RAYS)), 1.0 / RAYS
    s = (np.arange(image.shape[1]) + 0.5) * step - 0.5 - (columns - 1) / 2
    t = (np.arange(image.shape[0]) + 0.5) * step - 0.5 - (rows - 1) / 2
    for centre, number in zip(*lattice(), strict=True):
        at = centre + shift
        i = np.flatnonzero(np.abs(s - at.real) < 10)
        j = np.flatnonzero(np.abs(t - at.imag) < 10)
        if not len(i) or not len(j):
            continue
        u, v = s[i] - at.real, (t[j] - at.imag)[:, None]
        lit = 0.5 * erfc((np.hypot(u, v) - DISC.radius_px) / (DISC.blur_px * 2**0.5))
        image[np.ix_(j, i)] += lit * light(u, v, number)
    return image.reshape(rows, RAYS, columns, RAYS).mean((1, 3))


def measured(image, regions=1, about=0.0):
    """Shifts of regions, columns of the sensor from small s to large, from ``about`` beside the lattice."""
    places = lattice()[0] + about
    places = places[inside(SHAPE, places, DISC.half_window)]
    region = np.clip(((places.real / SHAPE[1] + 0.5) * regions).astype(int), 0, regions - 1)
    return region_shifts(image, places, region, regions, DISC)


def even(u, v, number):
    return 100.0


def one_sided(u, v, number):
    """Light from one side, brighter from lens to lens: the edge of a lit volume."""
    return 100.0 * (1 + 0.08 * u - 0.03 * v + 0.004 * u * v + 4e-4 * u**3) * (1 + 0.03 * number.real)


@pytest.mark.parametrize("light", [even, one_sided])
@pytest.mark.parametrize("shift", [0.2, 0.2j, -0.15 + 0.1j])
def test_a_shift_along_each_axis_is_found_whatever_the_light(light, shift):
    image = drawn(shift, light)
    assert abs(measured(image).shift[0] - shift) < 0.2 * abs(shift)  # a linear fit: the rest in a second one
    assert abs(measured(image, about=shift).shift[0]) < 0.01


def test_regions_are_fitted_by_themselves_and_unlit_ones_not():
    def right(u, v, number):
        return 100.0 * (number.real > 0)

    found = measured(drawn(0.1, right), 4)
    assert found.light[0] == pytest.approx(0.0, abs=1e-6)
    assert abs(found.shift[3] - measured(drawn(0.0, right), 4).shift[3] - 0.1) < 0.02
    assert found.light[3] == pytest.approx(100.0, rel=0.02)


def test_the_variance_is_that_of_independent_noise():
    rng = np.random.default_rng(1)
    image = drawn(0.0, even)
    found = [measured(image + rng.normal(0.0, 20.0, SHAPE)) for _ in range(30)]
    shifts = np.array([each.shift[0] for each in found])
    scatter = 0.5 * (shifts.real.var() + shifts.imag.var())
    assert np.mean([each.variance[0] for each in found]) == pytest.approx(scatter, rel=0.35)


def test_a_microlens_with_an_unusable_pixel_has_no_part():
    image = drawn(0.0, even)
    spoilt = image.copy()
    spoilt[101:103, 100:102] = 2000.0
    masked = np.where(spoilt == 2000.0, np.nan, spoilt)
    clean = measured(image).shift[0]
    assert abs(measured(spoilt).shift[0] - clean) > 0.005
    assert abs(measured(masked).shift[0] - clean) < 0.001
    assert np.isnan(measured(np.full(SHAPE, np.nan)).shift[0])


def test_terms_are_light_of_all_discs_and_how_it_changes():
    """Against differences of the light of discs summed one by one."""

    def light(s, t, shift=0.0, radius=6.9, blur=0.4):
        total = 0.0
        for number in unit_centres("hexagonal", *(each.ravel() for each in np.mgrid[-1:2, -1:2])):
            r = abs(complex(s, t) - DISC.pitch * number - shift)
            total += 0.5 * erfc((r - radius) / (blur * 2**0.5))
        return total

    h = 1e-4
    for s, t in [(0.5, 0.2), (6.8, 0.4), (-3.0, 6.1), (3.9, 5.6), (-7.1, -0.3)]:
        terms = terms_of(np.array(s), np.array(t), DISC)
        assert terms[0] == pytest.approx(light(s, t), abs=1e-9)
        for k, step in enumerate(({"shift": h}, {"shift": 1j * h}, {"radius": h}, {"blur": h})):
            back = {key: -value for key, value in step.items()}
            add = {"radius": 6.9, "blur": 0.4, "shift": 0.0}
            high, low = ({key: add[key] + value for key, value in each.items()} for each in (step, back))
            slope = (light(s, t, **high) - light(s, t, **low)) / (2 * h)
            assert terms[TERMS + k] == pytest.approx(slope, abs=1e-5)
    inner = terms_of(np.array(2.0), np.array(1.0), DISC)
    for k, (p, q) in enumerate(LIGHT_POWERS):
        assert inner[k] == pytest.approx((2.0 / DISC.reach_px) ** p * (1.0 / DISC.reach_px) ** q, abs=1e-9)
