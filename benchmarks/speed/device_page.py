"""Write what was predicted and measured of devices into docs/gpu.md:  device_page.py

Reads device-predicted.json and device-jax-cpu.json beside this file, and device-gpu.json where there is one. Only what
stands between the two marks is replaced.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from speed_page import table

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "gpu.md"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def main() -> None:
    parts = [predicted(read("predicted")), processor(read("jax-cpu"))]
    if (HERE / "device-gpu.json").exists():
        parts.append(measured(read("gpu")))
    before, _, rest = PAGE.read_text().partition(BEGIN)
    _, _, after = rest.partition(END)
    PAGE.write_text(before + BEGIN + "\n\n" + "\n\n".join(parts) + "\n\n" + END + after)


def read(name: str) -> dict[str, Any]:
    return json.loads((HERE / f"device-{name}.json").read_text())


def predicted(found: dict[str, Any]) -> str:
    nz, ny, nx = found["shape"]
    rows = [
        [
            card["card"],
            str(card["tiles"]),
            f"{card['frame_gb']:.1f}",
            f"{card['pair_gb']:.1f}{'' if card['pair_resident'] else ', some planes at a time'}",
            f"{card['frame_s']:.0f}",
            f"{card['correlation_s'] + card['host_s'] + card['link_s']:.0f}",
            f"{card['pair_of_frames_s']:.0f}",
        ]
        for card in found["cards"]
    ]
    header = "device | tiles | a frame, GB | correlation, GB | a frame, s | correlation, s | whole pair, s"
    size = f"6600 x 4400 px, {nx} x {ny} x {nz} voxels, {found['views']} views"
    words = f"**Predicted**, the paper's full size: {size}, five iterations, default settings."
    return f"{words} Memory is what the compiled programs ask for:\n\n" + table(header, rows)


def processor(found: dict[str, Any]) -> str:
    return "**Measured**, the same code on this processor; shares fitted to the second size:\n\n" + stages(found)


def measured(found: dict[str, Any]) -> str:
    return f"**Measured**, {found['device']}; shares fitted to the second size:\n\n" + stages(found)


def stages(found: dict[str, Any]) -> str:
    rows = []
    for each in [*found["pairs"], *found["frames"]]:
        size = " x ".join(map(str, each["shape"][::-1]))
        for name, stage in each["stages"].items():
            ratio = f"{stage['predicted_s'] / stage['seconds']:.2f}"
            rows.append([size, name, f"{stage['seconds']:.3f}", f"{stage['bytes_per_s'] / 1e9:.1f}", ratio])
    return table("voxels | stage | s | GB/s | predicted over measured", rows)


if __name__ == "__main__":
    main()
