"""The score of a velocity field by loops over vectors and particles, from its definition in ``accuracy.velocity``.

What every view sees is found with rays through both rims of the main lens. No code is shared with what it tests but the
camera's two functions of depth (Eqs. 1-3).
"""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np


def seen_by_all(camera, place, half_mm) -> bool:
    """Whether every view sees the whole of a window at its depth: all four corners, through both rims."""
    x, y, z = place
    a, b = float(camera.spread(z)), float(camera.scale(z))
    pixel = camera.sensor.pixel_pitch_mm / (1 + camera.image_scale)
    for coordinate, half, count in ((x, half_mm[0], camera.sensor.columns), (y, half_mm[1], camera.sensor.rows)):
        for edge, rim in product((-1, 1), (-0.5, 0.5)):
            if abs(a * rim * camera.main_lens.aperture_mm + b * (coordinate + edge * half)) > 0.5 * count * pixel:
                return False
    return True


def fitted(place, middle, moved, terms):
    """The value at ``place`` of a least-squares fit of ``terms`` (1 linear, 2 quadratic) to displacements ``moved``."""
    rows = []
    for at in middle:
        x, y, z = at - place
        row = [1.0, x, y, z]
        if terms == 2:
            row += [x * x, y * y, z * z, x * y, x * z, y * z]
        rows.append(row)
    return np.linalg.lstsq(np.array(rows), moved, rcond=None)[0][0]


def errors_of(measured, true, depth):
    """Gross share, RMS, bias, and RMS of thirds by depth, of the errors (n, 3) in voxels."""
    good, gross = [], 0
    for found, right, z in zip(measured, true, depth, strict=True):
        error = np.asarray(found) - right
        if max(abs(error)) > 2.0:
            gross += 1
        else:
            good.append((z, error))
    edges = np.quantile([z for z, _ in good], [0, 1 / 3, 2 / 3, 1])
    thirds = [[e for z, e in good if lo <= z <= hi] for lo, hi in pairwise(edges)]
    every = np.array([e for _, e in good])
    return {
        "gross": gross / len(measured),
        "rms": np.sqrt(np.mean(every**2, 0)),
        "bias": np.mean(every, 0),
        "by_depth": [np.sqrt(np.mean(np.square(third), 0)) for third in thirds],
    }


def naive_score(dataset, a_mm, b_mm, camera, *, dt_s, voxel_mm, window_voxels):
    """Score of a dataset of dims (time, z, y, x) with u, v, w, their _raw and _std, and valid."""
    a_mm, b_mm, voxel = np.asarray(a_mm, float), np.asarray(b_mm, float), np.asarray(voxel_mm, float)
    half, middle, moved = 0.5 * voxel * np.asarray(window_voxels), 0.5 * (a_mm + b_mm), b_mm - a_mm
    lo, hi = middle.min(0) + half, middle.max(0) - half
    kept, counts, window, point = [], [], [], []
    for k, j, i in np.ndindex(dataset["u"].shape[1:]):
        place = np.array([float(dataset.x[i]), float(dataset.y[j]), float(dataset.z[k])])
        if not ((place >= lo).all() and (place <= hi).all() and seen_by_all(camera, place, half)):
            continue
        off = np.abs(middle - place) / half
        inside, around = (off <= 1.0).all(1), (off <= 1.3).all(1)
        if inside.sum() < 6:
            continue
        kept.append((k, j, i))
        counts.append(int(inside.sum()))
        window.append(fitted(place, middle[inside], moved[inside], 1) / voxel)
        enough = around.sum() >= 16
        point.append(fitted(place, middle[around], moved[around], 2) / voxel if enough else np.full(3, np.nan))

    def values(suffix):
        columns = [[float(dataset[name + suffix].values[0][at]) for name in "uvw"] for at in kept]
        return np.array(columns) * 1e3 * dt_s / voxel

    depth = [abs(float(dataset.z[k])) for k, _, _ in kept]
    final, std = values(""), values("_std")
    steps = [np.arange(first, last + 1e-9, step) for first, last, step in zip(lo, hi, half, strict=True)]
    return {
        "vectors": len(kept),
        "vectors_at_half_overlap": sum(seen_by_all(camera, place, half) for place in product(*steps)),
        "particles_per_window": np.mean(counts),
        "final": errors_of(final, window, depth),
        "raw": errors_of(values("_raw"), window, depth),
        "final_at_point": errors_of(final, point, depth),
        "replaced": np.mean([dataset["valid"].values[0][at] == 0 for at in kept]),
        "inside": [np.mean(np.abs(final - window) <= n * std, axis=0) for n in (1, 2)],
    }
