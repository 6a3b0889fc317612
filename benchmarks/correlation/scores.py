"""Errors of measured displacements, and their tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.accuracy.velocity import GROSS_VOXELS

BIAS_AIM, RMS_AIM = 0.01, 0.03  # voxel, uniform shift


@dataclass
class Errors:
    """Errors of some of the windows, voxels, components x, y, z; gross ones left out.

    ``bias``: mean error of the worst pair along each axis; over all pairs a pull toward zero would cancel.
    ``toward_zero``: mean of -error * sign(displacement) over all pairs. ``gross``: share of windows with an error above
    ``GROSS_VOXELS`` on any axis, or without a peak.
    """

    windows: int
    gross: float
    bias: tuple[float, ...]
    toward_zero: tuple[float, ...]
    rms: tuple[float, ...]


@dataclass
class Row:
    """One method under one condition.

    ``inner``: windows that the outermost layer surrounds. ``response``: measured over true displacement along x, by
    least squares. ``about_response``: RMS along x of what is left when the truth is multiplied by it, voxels.
    """

    condition: str
    method: str
    vectors_a_cpu_s: float
    everywhere: Errors
    inner: Errors
    response: float
    about_response: float


def row(condition: str, method: str, found: NDArray, truth: NDArray, seconds: float) -> Row:
    """``found``, ``truth``: (pair, component, nz, ny, nx)."""
    vectors = found[:, 0].size
    inner = (slice(None), slice(None), *(slice(1, -1),) * 3)
    fine = ~gross(found - truth)
    x, t = found[:, 0][fine], truth[:, 0][fine]
    response = float((x * t).sum() / (t * t).sum())
    about = float(np.sqrt(np.mean((x - response * t) ** 2)))
    both = errors(found, truth), errors(found[inner], truth[inner])
    return Row(condition, method, round(vectors / seconds, 1), *both, round(response, 4), round(about, 5))


def gross(error: NDArray) -> NDArray[np.bool_]:
    """(pair, component, nz, ny, nx) to (pair, nz, ny, nx); NaN is gross."""
    return ~(np.abs(error) <= GROSS_VOXELS).all(1)


def errors(found: NDArray, truth: NDArray) -> Errors:
    error, wrong = found - truth, gross(found - truth)
    counted = np.broadcast_to(~wrong[:, None], error.shape)
    everything, of_a_pair = (0, 2, 3, 4), (2, 3, 4)
    return Errors(
        wrong.size,
        round(float(wrong.mean()), 5),
        triple(np.abs(np.mean(error, of_a_pair, where=counted)).max(0)),
        triple(np.mean(-error * np.sign(truth), everything, where=counted)),
        triple(np.sqrt(np.mean(error**2, everything, where=counted))),
    )


def triple(values: NDArray) -> tuple[float, ...]:
    return tuple(round(float(v), 5) for v in values)


def three(values: tuple[float, ...], digits: int = 3) -> str:
    return " / ".join(f"{v:.{digits}f}" for v in values)


def aims(e: Errors) -> str:
    missed = [name for name, miss in (("bias", max(e.bias) > BIAS_AIM), ("RMS", max(e.rms) > RMS_AIM)) if miss]
    return " and ".join(missed) + " missed" if missed else "met"


def markdown(head: str, text_columns: int, cells: list[list[str]]) -> str:
    """A table: its first columns hold text, the others figures."""
    divider = "|" + "---|" * text_columns + "---:|" * (head.count("|") - 1 - text_columns)
    return "\n".join([head, divider, *("| " + " | ".join(line) + " |" for line in cells)])


def shift_table(rows: list[Row]) -> str:
    head = (
        "| volumes | method | windows | aims | number | gross % | bias x / y / z | toward zero x / y / z |"
        " RMS x / y / z | vectors a CPU-s |"
    )
    cells = []
    for r in rows:
        for part, e in (("all", r.everywhere), ("inner", r.inner)):
            figures = [str(e.windows), f"{100 * e.gross:.2f}", three(e.bias), three(e.toward_zero), three(e.rms)]
            cells.append([r.condition, r.method, part, aims(e), *figures, f"{r.vectors_a_cpu_s:.0f}"])
    return markdown(head, 4, cells)


def wave_table(rows: list[Row]) -> str:
    head = (
        "| wavelength, windows | method | windows | gross % | response | RMS about the response, x | RMS x / y / z |"
        " vectors a CPU-s |"
    )
    cells = []
    for r in rows:
        e = r.everywhere
        figures = [str(e.windows), f"{100 * e.gross:.2f}", f"{r.response:.3f}", f"{r.about_response:.3f}", three(e.rms)]
        cells.append([r.condition, r.method, *figures, f"{r.vectors_a_cpu_s:.0f}"])
    return markdown(head, 2, cells)
