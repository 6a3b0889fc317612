"""Quality of tomographic reconstructions against particles per pixel, with a figure (docs/tomo.md).

    .venv/bin/python benchmarks/tomo/quality.py              # a quarter of an hour
    .venv/bin/python benchmarks/tomo/quality.py --reduced --out build/tomo

Q after Elsinga et al. (2006, section 3) against Gaussian particles of 3 voxels; ghosts as the share of light further
than 3 voxels from every particle (``plenopiv.accuracy``).
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
from four_cameras import ELECTRONS, Scene
from matplotlib import pyplot as plt

from plenopiv.accuracy import exact_volume, ghost_light, reconstruction_quality
from plenopiv.chain import Chain
from plenopiv.reconstruction.settings import TOMOGRAPHY, ReconstructionSettings

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PPP = (0.01, 0.025, 0.05, 0.1, 0.15)
PLAIN, LABORATORY, PAPER = "depth a quarter of the width", "the same, calibrated and noisy", "the paper's volume"
COLOURS = {PLAIN: "#1f6fb2", LABORATORY: "#3c8d4f", PAPER: "#d9822b"}
INK = "#1f2933"
ADEQUATE = 0.75  # Elsinga et al. (2006)
BASE = Scene((448, 448, 112), (528, 528), 0.05)
PAPER_SCENE = Scene((486, 324, 270), (640, 480), 0.05)  # 36 x 24 x 20 mm
SMALL = Scene((96, 96, 24), (128, 128), 0.05)


def measured(scene: Scene, settings: ReconstructionSettings) -> dict[str, Any]:
    found = Chain(tuple(scene.known_cameras), scene.grid, settings).reconstruct(scene.images())
    exact = exact_volume(scene.place_mm, ELECTRONS, scene.grid)
    return {
        "ppp": scene.ppp, "particles": len(scene.place_mm), "voxels": list(scene.shape), "pixels": list(scene.pixels),
        "cameras": scene.cameras, "angle_deg": scene.angle_deg, "diameter_px": scene.diameter_px,
        "laboratory": scene.laboratory, "iterations": settings.iterations, "relaxation": settings.relaxation,
        "Q": round(reconstruction_quality(found.volume, exact), 4),
        "ghost_light": round(ghost_light(found.volume, scene.place_mm), 4),
        "candidates": round(found.candidates, 4),
    }  # fmt: skip


def cases(reduced: bool):
    """(group, what is varied, scene, settings)."""
    usual = TOMOGRAPHY
    base = SMALL if reduced else BASE
    for name, scene in ((PLAIN, base), (LABORATORY, base.having(laboratory=True)), (PAPER, PAPER_SCENE)):
        if not (reduced and name == PAPER):
            for ppp in PPP[1:3] if reduced else PPP:
                yield "density", name, scene.having(ppp=ppp), usual
    if reduced:
        return
    for number in (2, 3):
        yield "choices", f"{number} cameras", base.having(cameras=number), usual
    for angle in (10.0, 30.0):
        yield "choices", f"angles of {angle:g} degrees", base.having(angle_deg=angle, pixels=(576, 576)), usual
    for diameter in (2.0, 2.5, 3.0, 3.5):
        yield "choices", f"images of {diameter:g} px", base.having(diameter_px=diameter), usual
    for number in (1, 2, 3, 10, 20):
        yield "choices", f"{number} iterations", base, replace(usual, iterations=number)
    for relaxation in (0.25, 0.5):
        yield "choices", f"relaxation {relaxation:g}", base, replace(usual, relaxation=relaxation)


def draw(rows: list[dict[str, Any]], file: Path) -> None:
    plt.rcParams.update({"font.size": 9.0, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    for name, colour in COLOURS.items():
        line = [r for r in rows if r["case"] == name]
        for ax, key in zip(axes, ("Q", "ghost_light"), strict=True):
            ax.plot([r["ppp"] for r in line], [r[key] for r in line], "o-", color=colour, ms=4, lw=1.6, label=name)
    axes[0].axhline(ADEQUATE, color=INK, lw=0.8, ls=":")
    axes[0].text(0.004, ADEQUATE - 0.015, "adequate (Elsinga et al. 2006)", va="top", fontsize=8, color=INK)
    axes[0].set(ylabel="quality Q", ylim=(0.0, 1.0))
    axes[1].set(ylabel="ghosts, share of the light", ylim=(0.0, None))
    for ax in axes:
        ax.set(xlabel="particles per pixel", xlim=(0.0, 0.16))
    figure.legend(*axes[0].get_legend_handles_labels(), frameon=False, ncols=3, loc="outside lower center")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110, facecolor="white")
    plt.close(figure)


def main(reduced: bool = False, out: Path | None = None) -> list[dict[str, Any]]:
    rows = []
    for group, name, scene, settings in cases(reduced):
        rows.append({"group": group, "case": name, **measured(scene, settings)})
        last = rows[-1]
        shown = f"Q {last['Q']}, ghosts {last['ghost_light']}, kept {last['candidates']}"
        print(f"{name}, {last['ppp']} ppp: {shown}", flush=True)
    numbers, picture = (HERE, ROOT / "docs" / "images" / "paper") if out is None else (out, out)
    numbers.mkdir(parents=True, exist_ok=True)
    lines = ",\n".join(" " + json.dumps(row) for row in rows)
    (numbers / "quality.json").write_text(f"[\n{lines}\n]\n")
    draw(rows, picture / "tomo-quality.png")
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reduced", action="store_true", help="a small volume, in seconds")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="for picture and numbers alike")
    arguments = parser.parse_args()
    main(arguments.reduced, arguments.out)
