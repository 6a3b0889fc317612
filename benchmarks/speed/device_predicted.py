"""The full-size frame on graphics processors, predicted:  device_predicted.py [condition]

Memory is that of the compiled programs, with the tiles that 8, 24 and 80 GB ask for; times follow from bytes and
operations of each stage (plenopiv.device.work) and what makers state of bandwidth and rate, with assumed shares of
both. Nothing is computed on a device. Writes device-predicted.json beside this file.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "accuracy"))
from conditions import CONDITIONS

from plenopiv.chain import Chain
from plenopiv.device import work
from plenopiv.device.backend import device_of
from plenopiv.device.correlation_memory import BATCH_VOXELS, room
from plenopiv.device.plan import frame_of, frame_work
from plenopiv.device.rates import CARDS
from plenopiv.device.work_of_frames import LISTED
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.reconstruction.tiles import cut
from plenopiv.volume import VoxelGrid

HOST_CORES = 16
SENT = 6.0  # bytes a listed voxel, there and back


def main() -> None:
    name = sys.argv[1] if len(sys.argv) > 1 else "full"
    condition, device = CONDITIONS[name], device_of("jax-cpu")
    grid = VoxelGrid.covering(*condition.volume_mm(), condition.voxel_mm())
    correlation = CorrelationSettings(windows=condition.windows)
    chain = Chain((condition.camera(),), grid, correlation=correlation)
    projection, rows = chain.projection, grid.shape[1]
    with device.in_use():
        frame = frame_work(projection, chain.reconstruction).stages
    pair = work.correlation(grid.shape, correlation, BATCH_VOXELS)
    on_host = work.ON_HOST * work.vectors(grid.shape, correlation) / HOST_CORES
    out = {"condition": name, "shape": list(grid.shape), "views": projection.views, "cards": []}
    for card in CARDS:
        lends = 0.9 * card.memory
        tiles, taken = frame_of(projection, chain.reconstruction, replace(device, memory=lends), cut(rows, 1, 0))
        plan = room(grid.shape, correlation, lends, voxels=BATCH_VOXELS)
        share = sum(tile.high - tile.low for tile in tiles) / rows
        link = 2 * SENT * LISTED * grid.size / card.link
        sent = link if plan.resident else link + 4 * (1 + 16 / 5) * 2 * len(correlation.passes) * grid.size / card.link
        stages = {key: share * seconds for key, seconds in card.seconds(frame).items()} | card.seconds(pair)
        found = {
            "card": card.name,
            "tiles": len(tiles),
            "frame_gb": taken.bytes / 1e9,
            "pair_gb": plan.needed / 1e9,
            "pair_resident": plan.resident,
            "frame_s": sum(stages[key] for key in frame),
            "correlation_s": sum(stages[key] for key in pair),
            "host_s": on_host,
            "link_s": sent,
            "stages_s": stages,
        }
        found["pair_of_frames_s"] = 2 * found["frame_s"] + found["correlation_s"] + on_host + sent
        out["cards"].append(found)
        print(json.dumps(found, indent=1), flush=True)
    out["frame_bytes"] = {key: stage.moved for key, stage in frame.items()}
    out["pair_bytes"] = {key: stage.moved for key, stage in pair.items()}
    (Path(__file__).parent / "device-predicted.json").write_text(json.dumps(out, indent=1) + "\n")


if __name__ == "__main__":
    main()
