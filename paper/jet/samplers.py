"""Divergence that interpolation adds: splines of degree 1, 3, 5 against splines of mixed degree, on a solution.

python paper/jet/samplers.py build/jet/192x128x128/state-010.0.npz      writes paper/jet/samplers.json

The solution itself is free of divergence to rounding. Figures are the largest divergence at points in the jet over the
largest component of the gradient there, the RMS over the RMS, and the time of one evaluation.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from scipy.interpolate import NdBSpline
from scipy.ndimage import spline_filter1d

from plenopiv.simulation.gridded import GriddedVelocity

ROOT = Path(__file__).parents[2]
POINTS = 20_000


def equal_degrees(values, degree: int):
    """A periodic interpolating spline of one degree over (z, y, x), at (n, 3) indices along x, y, z."""
    knots = []
    for axis, points in enumerate(values.shape[:3]):
        if degree > 1:
            values = spline_filter1d(values, degree, axis=axis, mode="grid-wrap")
        reach = np.arange(-(degree // 2), points + degree - degree // 2)
        values = np.take(values, reach, axis=axis, mode="wrap")
        knots.append(np.arange(-degree, points + degree + 1, dtype=float))
    spline = NdBSpline(tuple(knots), np.ascontiguousarray(values), degree)
    return lambda index: spline(index[:, ::-1])


def measured(velocity, points, step: float = 1e-3) -> dict[str, float]:
    """Divergence by central differences over ``step`` grid intervals, and microseconds for a point."""
    g = np.stack([(velocity(points + h) - velocity(points - h)) / (2 * step) for h in step * np.eye(3)], -1)
    divergence = np.trace(g, axis1=1, axis2=2)
    begin = time.process_time()
    velocity(points)
    seconds = time.process_time() - begin
    return {
        "largest": float(np.abs(divergence).max() / np.abs(g).max()),
        "rms": float(np.sqrt((divergence**2).mean() / (g**2).mean())),
        "us_for_a_point": seconds / len(points) * 1e6,
    }


def main() -> None:
    """Measure and write."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("state", type=Path)
    arguments.add_argument("--out", type=Path, default=ROOT / "paper" / "jet" / "samplers.json")
    wanted = arguments.parse_args()
    with np.load(wanted.state) as state:
        values, box = np.stack([state[f"v{axis}"] for axis in "xyz"], -1), state["box"]
    size = np.array(values.shape[2::-1])
    rng = np.random.default_rng(0)
    r, a = 0.3 + 0.5 * rng.random(POINTS), 2.0 * np.pi * rng.random(POINTS)
    place = np.stack([box[0] * rng.random(POINTS), box[1] / 2 + r * np.cos(a), box[2] / 2 + r * np.sin(a)], -1)
    points = place * size / box
    rows = {f"degree {k}": measured(equal_degrees(values, k), points) for k in (1, 3, 5)}
    mixed = GriddedVelocity(values, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), "periodic")
    rows["mixed, 4 and 3"] = measured(mixed, points)
    nodes = rng.integers(0, size, (POINTS, 3))
    misses = mixed(nodes.astype(float)) - values[nodes[:, 2], nodes[:, 1], nodes[:, 0]]
    rows["mixed, 4 and 3"]["rms_at_grid_points_U"] = float(misses.std())
    wanted.out.write_text(json.dumps(rows, indent=2) + "\n")
    print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
