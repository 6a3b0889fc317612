"""Static light taken off: errors against those of the clean recording. Writes its part of docs/spoilt.md.

    python benchmarks/accuracy/static_light.py [NAME ...] [--out DIR]

Thirty pairs on the small camera, lit beside their particles in one way at a time and in all ways at once; pulses vary
by 3 %. Measured are the first ten of them, with images of the static light of each pulse and a dark image
(``recording.background``, ``recording.dark``), and with ``recording.background = "minimum"`` of all thirty. Exits with
1 where errors are more than 1.15 times those of the clean recording, or error bars too short.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from small_recording import CAMERA, DARK_FRAMES, DT_S, NOISE, WINDOWS, Clean, Counts, clean_recording
from spoiling import BLACK, GLOW, REFLECTION, SENSOR, Copy, dimmed, read, spot, write
from spoilt import MOST, ROOT, digest, write_page

from plenopiv.accuracy import score_velocity
from plenopiv.accuracy.velocity import Score, pooled
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.frame import reconstructed

HERE = Path(__file__).parent
RECORDED = HERE / "static_light.json"
PAIRS, MEASURED = 30, 10  # of three pairs shares within two standard deviations are known to 1 %
SATURATED_AT, SATURATED_RADIUS_PX = (180.0, 640.0), 20.0  # row and column
SATURATED = spot(12000.0, *SATURATED_AT, 12.0)
HOT_COUNTS, HOT_SHARE = 800.0, 1e-4
MEAN_LIGHT, VARIES = 0.95, 0.03  # of the pulses
WITHIN = ((0.60, 0.80), (0.90, 0.98))  # of the errors, one and two standard deviations
BLUR_PX = 57.0  # half width of a particle's image at either end of the volume


@dataclass(frozen=True)
class Light:
    """``static`` counts of the first pulse at its full light; ``second``: light of the second pulse over it."""

    what: str
    static: Counts | float = 0.0
    second: float = 1.0
    hot: bool = False
    saturated: bool = False


LIGHTS = {
    "clean": Light("nothing"),
    "glow": Light("smooth glow of 250 counts", GLOW),
    "reflection": Light("reflection of 900 counts, 28 px wide", REFLECTION),
    "saturated": Light("reflection that saturates pixels", SATURATED, saturated=True),
    "hot": Light("1e-4 of the pixels hot, 800 counts", hot=True),
    "second": Light("second pulse x0.6", second=0.6),
    "all": Light("all of it at once", GLOW + REFLECTION + SATURATED, 0.6, hot=True, saturated=True),
}
TRIED = {"clean": ("nothing",), "all": ("files", "minimum", "nothing")}
WAYS = {"files": "background and dark images", "minimum": '"minimum" of 30 pairs', "nothing": "nothing taken off"}


def lit(light: Light, copy: Copy, way: str) -> None:
    """Add the light to every frame of a copy, write the images that ``way`` needs, and name them."""
    hot = HOT_COUNTS * light.hot * (copy.rng.random((SENSOR.rows, SENSOR.columns)) < HOT_SHARE)

    def static(factor: float) -> Counts:
        return NOISE.gain * copy.rng.poisson(factor * light.static / NOISE.gain, hot.shape)

    for pulse, strength in (("a", 1.0), ("b", light.second)):
        for path in copy.frames(pulse):
            factor = strength * min(MEAN_LIGHT * (1 + VARIES * copy.rng.standard_normal()), 1.0)
            write(path, dimmed(read(path), factor, copy.rng) + static(factor) + hot)
        if way == "files":
            dark = NOISE.gain * NOISE.read_noise_electrons  # counts
            each = (static(MEAN_LIGHT * strength) + copy.rng.normal(BLACK, dark, hot.shape) for _ in range(DARK_FRAMES))
            mean = np.mean([np.clip(np.rint(frame + hot), 0, SENSOR.full_scale) for frame in each], axis=0)
            write(copy.folder / f"background_{pulse}.tif", mean)
    dark = copy.folder / "dark.tif"
    write(dark, read(dark) + hot)
    if way == "files":
        copy.key("recording.dark", "dark.tif")
        copy.key("recording.background", ["background_a.tif", "background_b.tif"])
    elif way == "minimum":
        copy.key("recording.background", "minimum")


def measured(experiment: Experiment, clean: Clean, leave_out: bool) -> list[Score]:
    """Scores of the first pairs; ``leave_out`` vectors whose particles light saturated pixels."""
    chain, recording, _ = calibrated_chain(experiment, experiment.recording())
    scores = []
    for pair in range(MEASURED):
        a, b = (reconstructed(chain, recording, k, lambda *done: None) for k in recording.pairs[pair])
        velocity = chain.velocity(a.found.volume, b.found.volume, DT_S)
        if leave_out:
            apart = ~near_saturated(velocity, experiment.volume.voxel_mm[0])
            velocity = velocity.assign({name: velocity[name].where(apart) for name in "uvw"})
        settings = {"dt_s": DT_S, "voxel_mm": experiment.volume.voxel_mm, "window_voxels": WINDOWS[-1]}
        scores.append(score_velocity(velocity, *clean.truth(pair), CAMERA, **settings))
    return scores


def near_saturated(velocity: Any, voxel_mm: float) -> Any:
    """Vectors in whose windows a particle may light the saturated reflection."""
    x, y, z = velocity.x, velocity.y, velocity.z
    scale = CAMERA.main_lens.magnification * (1 + CAMERA.image_scale)
    column = 0 * x + CAMERA.sensor.pixel_from_plane(scale * x, 0.0)[0]
    row = 0 * y + CAMERA.sensor.pixel_from_plane(0.0, scale * y)[1]
    half = 0.5 * WINDOWS[-1][0] * voxel_mm * abs(scale) / CAMERA.sensor.pixel_pitch_mm
    distance = np.hypot(row - SATURATED_AT[0], column - SATURATED_AT[1])
    return distance < half + SATURATED_RADIUS_PX + BLUR_PX * abs(z) / abs(z).max()


def shares_within(scores: Sequence[Score]) -> list[list[float]]:
    """Shares of the errors within one and two stated standard deviations, x y z, of the vectors that are judged."""
    return [
        np.mean([np.array(getattr(s, f"inside_{k}_std")) / s.final.answered for s in scores], axis=0).tolist()
        for k in (1, 2)
    ]


def row(name: str, way: str, scores: Sequence[Score], clean: Sequence[Score]) -> dict[str, Any]:
    """A line of the results."""
    here, there = pooled(scores), pooled(clean)
    ratio = [a / b for a, b in zip(here.rms, there.rms, strict=True)]
    within = shares_within(scores)
    bars = "as asked"
    if any(share > high for (_, high), shares in zip(WITHIN, within, strict=True) for share in shares):
        bars = "long"
    if any(share < low for (low, _), shares in zip(WITHIN, within, strict=True) for share in shares):
        bars = "short"
    line = {"name": name, "what": LIGHTS[name].what, "way": way, "rms": here.rms, "clean_rms": there.rms}
    line |= {"ratio": ratio, "gross": here.gross, "within": within, "answered": here.answered}
    fine = max(ratio) <= MOST and bars != "short" and here.gross <= there.gross + 0.01
    return line | {"bars": bars, "fine": bool(fine)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(LIGHTS))
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "spoilt", metavar="DIR")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", PlenoPIVWarning)
    simulation = digest(ROOT / "src" / "plenopiv" / "simulation", HERE / "small_recording.py")
    clean = clean_recording(arguments.out / f"thirty-{simulation}", PAIRS)
    experiment = Experiment.load(clean.folder / "experiment.toml")
    reference = {leave_out: measured(experiment, clean, leave_out) for leave_out in (False, True)}
    lines = []
    for name in arguments.names or LIGHTS:
        light = LIGHTS[name]
        for way in TRIED.get(name, ("files", "minimum")):
            with tempfile.TemporaryDirectory() as folder:
                copy = Copy(clean, Path(folder) / "recording", PAIRS if way == "minimum" else MEASURED, seed=1)
                lit(light, copy, way)
                scores = measured(Experiment.load(copy.save()), clean, light.saturated)
            line = row(name, WAYS[way], scores, reference[light.saturated])
            lines.append(line)
            triple = " / ".join(f"{r:.3f} ({q:.2f})" for r, q in zip(line["rms"], line["ratio"], strict=True))
            within = "; ".join(" ".join(f"{100 * s:.0f}" for s in shares) for shares in line["within"])
            judged = "fine" if line["fine"] else "OFF"
            print(f"{name:12s} {line['way']:28s} {triple}  within {within} % ({line['bars']})  {judged}", flush=True)
    if not arguments.names:
        RECORDED.write_text(json.dumps(lines, indent=1) + "\n")
        write_page()
    sys.exit(0 if all(line["fine"] for line in lines if line["way"] != WAYS["nothing"]) else 1)


if __name__ == "__main__":
    main()
