"""The jet with both frames of the plenoptic camera reconstructed together (motion-tracking enhancement):

    both_frames.py

In the volume of the reduced comparison, with sub-windows: errors against the mean of the DNS over the paper's window,
by depth, as reconstructed frame by frame and after one and two reconstructions from a first guess that the frames
share. Beyond 6 mm the fluid is nearly at rest, where ghosts move as particles do. Writes results/both_frames.json.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from comparison_scores import Judge
from comparison_settings import REDUCED, TINY
from lightfield_case import Reconstructed, correlation_of, reconstruct_light_field
from outputs import command_line, write_numbers

from plenopiv.motion_tracking import reconstruct_together
from plenopiv.simulation.flows import flow

KEPT = "vectors", "rms_voxel", "gross", "inside_1_std", "inside_2_std"
PASSES = 2


def together(pair: Reconstructed) -> Reconstructed:
    """The same, reconstructed once more from what both frames share."""
    setting, clock = pair.setting, pair.clock.continued()
    inner = setting.inner_window
    again = replace(pair.chain.reconstruction, motion_tracking=1)
    chain = replace(pair.chain, correlation=correlation_of(setting, inner), reconstruction=again)
    a, b = reconstruct_together(chain, pair.images, pair.volumes)
    clock.lap("together")
    return replace(pair, volumes=(a, b), clock=clock)


def main(out: Path, reduced: bool) -> None:
    """Measure and write."""
    setting = TINY if reduced else REDUCED
    jet, light_field = flow("jet", at_mm=setting.jet_at_mm), setting.light_field
    judge, pair = Judge(jet, light_field.judged_mm), reconstruct_light_field(light_field, jet)
    lines: list[dict[str, Any]] = []
    for passes in range(PASSES + 1):
        pair = together(pair) if passes else pair
        measured = pair.correlated(light_field.inner_window)
        bands = judge.score(measured)[0]["errors"]["window_mean"]
        spent = measured.clock.processor_s
        kept = {band: {key: e[key] for key in KEPT} for band, e in bands.items()}
        lines.append({"passes": passes, "bands": kept, "processor_s": spent})
        print(lines[-1], flush=True)
    write_numbers(out, "both_frames", lines)


if __name__ == "__main__":
    command_line(main, __doc__)
