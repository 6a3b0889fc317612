"""Bias of w in every millimetre of depth, from what run_conditions.py measured:  bias_by_depth.py [FOLDER]

Reads the recordings and results in FOLDER (build/accuracy) and writes the table into docs/accuracy.md. Judged are the
vectors whose whole window is seen by every view, against the particles in it, as in the scores; those that velocity.nc
marks as near focus or at the volume's front and back stand aside. Of a flow with bends the linear fit of a window's
particles is the truth.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import xarray
from conditions import CONDITIONS, DT_S

from plenopiv.accuracy.truth import true_displacements
from plenopiv.accuracy.velocity import GROSS_VOXELS
from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.displacement.field import NEAR_FACE
from plenopiv.experiment import Experiment

ROOT = Path(__file__).parents[2]
PAGE, BEGIN, END = ROOT / "docs" / "accuracy.md", "<!-- bias: begin -->\n", "<!-- bias: end -->"
ALLOWED = 0.01, 0.02  # of the displacement, or voxels
LEAST = 20  # vectors that a millimetre must have to be judged


def row(name: str, folder: Path) -> str | None:
    """The row of a condition, None where it was not measured."""
    if not (folder / "results" / "velocity.nc").exists():
        return None
    experiment = Experiment.load(folder / "experiment.toml")
    field = xarray.load_dataset(folder / "results" / "velocity.nc").isel(time=0)
    with np.load(folder / "truth_particles.npz") as particles:
        truth = particles["a"], particles["b"]
    voxel, (low, high) = np.array(experiment.volume.voxel_mm), experiment.volume.z_mm
    window = experiment.correlation.windows[-1]
    half, middle = 0.5 * voxel * window, 0.5 * (truth[0] + truth[1])
    z, y, x = np.meshgrid(field.z.values, field.y.values, field.x.values, indexing="ij")
    at, near = np.stack([x, y, z], -1).reshape(-1, 3), field.near_focus.values.ravel() == 1
    seen = np.stack(seen_by_every_view_mm(experiment.camera(), at[:, 2]), -1)
    chosen = ((at >= middle.min(0) + half) & (at <= middle.max(0) - half)).all(1) & ~near
    chosen &= (np.abs(at[:, :2]) + half[:2] <= seen + 1e-9).all(1)
    at = at[chosen]
    true = true_displacements(at, *truth, half).window / voxel
    found, std = (
        np.stack([field[each + end].values.ravel()[chosen] for each in "uvw"], -1) * 1e3 * DT_S / voxel
        for end in ("", "_std")
    )
    off = found - true
    fine = np.isfinite(off).all(1) & (np.abs(off) <= GROSS_VOXELS).all(1)
    face = np.minimum(at[:, 2] - low, high - at[:, 2]) < NEAR_FACE * window[2] * voxel[2]
    worst, where, beyond = 0.0, "", 0
    deep = np.floor(np.abs(at[:, 2])).astype(int)
    for mm in np.unique(deep):
        here = fine & ~face & (deep == mm)
        if here.sum() >= LEAST:
            bias = float(off[here, 2].mean())
            allowed = max(ALLOWED[0] * float(np.abs(true[here, 2]).mean()), ALLOWED[1])
            beyond += abs(bias) > allowed
            if abs(bias) > abs(worst):
                worst, where = bias, f"{mm} to {mm + 1}"
    kept, at_face = fine & ~face, fine & face
    inside = [" / ".join(f"{100 * v:.0f}" for v in (np.abs(off) <= k * std)[kept].mean(0)) for k in (1, 2)]
    return (
        f"| `{name}` | {kept.sum()} | {np.abs(true[fine, 2]).mean():.2f} | {off[kept, 2].mean():+.3f} | {worst:+.3f} | "
        f"{where} | {beyond} | {off[at_face, 2].mean():+.3f} | {inside[0]} | {inside[1]} |"
    )


def main() -> None:
    """Read, write."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else ROOT / "build" / "accuracy"
    lines = [
        "| condition | vectors | abs(w) | bias of w | largest in a mm of abs(z) | mm | mm beyond .02 voxel or 1 % | "
        "at front and back | within 1 std % | within 2 std % |",
        "|---|---:|---:|---:|---:|---|---:|---:|---|---|",
    ]
    lines += [each for name in CONDITIONS if (each := row(name, folder / name)) is not None]
    text = PAGE.read_text(encoding="utf-8")
    head, rest = text.split(BEGIN)
    PAGE.write_text(head + BEGIN + "\n".join(lines) + "\n" + END + rest.split(END)[1], encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
