"""Ways to spoil a recording: its light, what a camera's software does to images, and the white image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import tifffile
from small_recording import CAMERA
from spoiling import (
    BLACK,
    COLUMN,
    GLOW,
    MIDDLE,
    REFLECTION,
    SATURATED_REFLECTION,
    SENSOR,
    Case,
    Copy,
    Spoil,
    dimmed,
    read,
    write,
)


def _hot(copy: Copy) -> None:
    hot = copy.rng.random((SENSOR.rows, SENSOR.columns)) < 1e-4
    copy.change(lambda counts: counts + 800.0 * hot)


def _dead_rows(copy: Copy) -> None:
    def dead(counts):
        counts[300:303] = 0
        return counts

    copy.change(dead)
    write(copy.white, dead(read(copy.white)))


def _stuck(copy: Copy) -> None:
    """The particles of another recording, at rest."""
    light = np.maximum(read(copy.clean.folder / "run_04_a.tif") - BLACK, 0.0)
    copy.add(0.5 * np.where(light > 8.0, light, 0.0))


def weaker(factor: float, pulses: str = "b") -> Spoil:
    """Less light in all pairs."""
    return lambda copy: copy.change(lambda counts: dimmed(counts, factor, copy.rng), pulses)


def _amplified(factor: float, pairs: tuple[int, ...] | None = None) -> Spoil:
    return lambda copy: copy.change(lambda c: BLACK + factor * (c - BLACK), "ab", pairs)


def _gamma(copy: Copy) -> None:
    copy.change(lambda c: SENSOR.full_scale * (c / SENSOR.full_scale) ** (1 / 2.2))


def _smoothed(copy: Copy) -> None:
    from scipy.ndimage import median_filter

    copy.change(lambda c: median_filter(c, 3))


def _half_dark(copy: Copy, pairs) -> None:
    light = SENSOR.columns / 2 > COLUMN
    copy.change(lambda c: BLACK + (c - BLACK) * light + ~light * copy.rng.normal(0, 1.5, c.shape), "b", pairs)


def _white_in_frames(copy: Copy) -> None:
    copy.add(0.3 * np.maximum(read(copy.white) - BLACK, 0.0))


def _shifted_white(copy: Copy) -> None:
    write(copy.white, np.roll(read(copy.white), 1, axis=1))


def _moved_within(copy: Copy) -> None:
    copy.change(lambda c: np.roll(c, 1, axis=1), "ab", [2, 3])


def _stored(function) -> Spoil:
    """Frames written as other integers."""

    def spoil(copy: Copy) -> None:
        for path in copy.frames():
            write(path, function(tifffile.imread(path)))

    return spoil


WRONG_WHITE = ("other-camera", "white-moved")
STATIC = ("static-light", "background", "unexplained-light")

OF_LIGHT: dict[str, Case] = {
    "nothing": Case("nothing", lambda copy: None, fine=True),
    # light that is not the particles'
    "glow": Case("smooth glow of 250 counts", lambda copy: copy.add(GLOW), STATIC),
    "glow, 1 pair": Case("the same, one pair", lambda copy: copy.add(GLOW), STATIC, pairs=1),
    "reflection": Case("reflection of 900 counts, 28 px wide", lambda copy: copy.add(REFLECTION), STATIC),
    "reflection, 1 pair": Case("the same, one pair", lambda copy: copy.add(REFLECTION), STATIC, pairs=1),
    "saturated reflection": Case(
        "reflection that saturates pixels", lambda copy: copy.add(SATURATED_REFLECTION), (*STATIC, "overexposed")
    ),
    "stuck particles": Case("particles stuck to a window, half as bright", _stuck, STATIC),
    "hot pixels": Case("1e-4 of the pixels hot, 800 counts", _hot, ("hot-pixels", "static-light")),
    "hot pixels, 1 pair": Case("the same, one pair", _hot, ("hot-pixels", "static-light"), pairs=1),
    "dead rows": Case("three rows of the sensor dead", _dead_rows, ("dead-pixels",)),
    "white x0.3 added": Case("0.3 of the white image in every frame", _white_in_frames, STATIC),
    "background +300": Case("300 counts more in every pixel", lambda copy: copy.add(300.0 + 0 * COLUMN), STATIC),
    # pulses and exposure
    "second pulse x0.5": Case("second pulse x0.5", weaker(0.5), ("unequal-pulses", "pulses")),
    "second pulse x0.2": Case("second pulse x0.2", weaker(0.2), ("unequal-pulses", "pulses")),
    "gain x12": Case("gain x12, cut off at full scale", _amplified(12.0), ("overexposed",)),
    "one pair x12": Case("the same in one pair", _amplified(12.0, [MIDDLE]), ("overexposed",), (MIDDLE,)),
    "light x0.01": Case("light x0.01", weaker(0.01, "ab"), ("underexposed",)),
    "half dark": Case(
        "right half of one frame dark",
        lambda copy: _half_dark(copy, [MIDDLE]),
        ("unequal-pulses", "partly-dark"),
        (MIDDLE,),
    ),
    "half dark, all": Case(
        "right half of every second frame dark",
        lambda copy: _half_dark(copy, None),
        ("unequal-pulses", "partly-dark"),
    ),
    # what software does to images
    "gamma": Case("gamma of 2.2 in the camera", _gamma, ("black-level", "background", "unexplained-light")),
    "median filter": Case("median filter of 3 x 3 in the camera", _smoothed, ("filtered",)),
    "black subtracted": Case(
        "black level subtracted by the camera", lambda copy: copy.change(lambda c: c - BLACK), ("black-level",)
    ),
    "8 bits": Case("frames saved as 8 bits", _stored(lambda c: (c >> 4).astype(np.uint8))),
    "upper bits": Case("counts in the upper 12 of 16 bits", _stored(lambda c: c << 4)),
    "binned": Case("frames binned 2 x 2", _stored(lambda c: c[::2, ::2].copy())),
    "colour": Case("frames saved in colour", _stored(lambda c: np.stack([c] * 3, -1))),
    # white image
    "white moved 1 px": Case("white image shifted by 1 px", _shifted_white, WRONG_WHITE),
    "white pitch +0.5 %": Case(
        "white image of a pitch 0.5 % larger",
        lambda copy: copy.another_white(copy.lattice(pitch_mm=1.005 * CAMERA.lattice.pitch_mm)),
        WRONG_WHITE,
    ),
    "white pitch +1.5 %": Case(
        "white image of a pitch 1.5 % larger",
        lambda copy: copy.another_white(copy.lattice(pitch_mm=1.015 * CAMERA.lattice.pitch_mm)),
        WRONG_WHITE,
    ),
    "white turned 0.3 deg": Case(
        "white image of an array turned by 0.3 degrees",
        lambda copy: copy.another_white(copy.lattice(rotation_rad=0.002 + np.radians(0.3))),
        WRONG_WHITE,
    ),
    "white of f/1.25 of it": Case(
        "white image of an aperture 0.8 times as wide",
        lambda copy: copy.another_white(
            replace(CAMERA, main_lens=replace(CAMERA.main_lens, aperture_mm=0.8 * CAMERA.main_lens.aperture_mm))
        ),
        ("f-number", "stated-aperture", "white-aperture"),
    ),
    "moved within": Case("array moved by 1 px after two of four pairs", _moved_within, WRONG_WHITE, (2, 3)),
}
