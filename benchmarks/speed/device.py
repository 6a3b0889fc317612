"""Each stage on a device, measured beside what its bandwidth allows:  device.py [gpu | jax-cpu] [frames] [more]

On a graphics processor where there is one, else the same code on this processor. Volumes are of three or four sizes;
the shares of bandwidth and rate that stages reach are fitted to the second and predict the others. Writes
device-gpu.json or device-jax-cpu.json beside this file, and prints a table. With ``frames`` the reconstruction alone is
measured anew, and the file's rates and pairs stay; with ``more`` rounds are added to those that the file has: of each
stage whose work is the same the best of all is kept, as a machine that others use is slow for minutes.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from device_frames import SIZES, Frame, in_rounds
from scipy.ndimage import gaussian_filter

from plenopiv.device import correlation, work
from plenopiv.device.backend import device_of
from plenopiv.device.correlation_deformation import Deformed
from plenopiv.device.correlation_memory import room
from plenopiv.device.correlation_windows import How
from plenopiv.device.rates import Rates, bare, best
from plenopiv.displacement.depth_response import sample_of
from plenopiv.displacement.predictor import SplineField, fit_spline
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.window_pass import WindowPass
from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import DenseVolume, VoxelGrid

HERE = Path(__file__).parent
SETTINGS = CorrelationSettings(((40, 40, 20), (32, 32, 16)), inner_window=(32, 32, 16))
FITTED = 1  # the second size
SHAPES = {
    "jax-cpu": ((56, 144, 160), (72, 192, 224), (88, 256, 288), (104, 320, 352)),  # planes, rows, columns
    "gpu": ((96, 384, 384), (160, 640, 640), (240, 1200, 1600)),
}


def main() -> None:
    asked = sys.argv[1] if len(sys.argv) > 1 else "auto"
    if (device := device_of(asked)).kind == "cpu":
        device = device_of("jax-cpu")
    with device.in_use():
        print(device.text)
        frames_alone, more = ("frames" in sys.argv[2:]), ("more" in sys.argv[2:])
        file = HERE / f"device-{device.kind}.json"
        kept = json.loads(file.read_text()) if frames_alone or more else None
        rates = bare(device) if kept is None else Rates(**kept["rates"])
        found = (
            kept["pairs"]
            if kept is not None and frames_alone
            else in_rounds([Pair(shape) for shape in SHAPES[device.kind]])
        )
        whole = in_rounds([Frame(size) for size in SIZES[device.kind]])
    if kept is not None and more:
        best_of_both(found, kept["pairs"])
        best_of_both(whole, kept["frames"])
    shares = {}
    for measured in (found, whole):
        shares |= {name: share(rates, stage) for name, stage in measured[FITTED]["stages"].items()}
    fitted = replace(rates, shares=shares)
    for each in [*found, *whole]:
        for name, stage in each["stages"].items():
            stage["predicted_s"] = fitted.of_stage(name, work_of(stage))
            stage["share_of_bandwidth"] = stage["moved"] / rates.bandwidth / stage["seconds"]
            stage["bytes_per_s"] = stage["moved"] / stage["seconds"]
    result = {
        "device": device.name,
        "versions": dict(device.versions),
        "rates": {key: value for key, value in vars(rates).items() if key != "shares"},
        "shares": shares,
        "settings": {"windows": SETTINGS.windows, "inner_window": SETTINGS.inner_window},
        "pairs": found,
        "frames": whole,
    }
    file.write_text(json.dumps(result, indent=1) + "\n")
    tell(result)


def best_of_both(found: list[dict[str, Any]], before: list[dict[str, Any]]) -> None:
    """Keep the seconds of a size or a stage from ``before`` where they are less, if it does the same work."""
    for now, then in zip(found, before, strict=True):
        alike = {name for name, stage in now["stages"].items() if work_of(stage) == work_of(then["stages"][name])}
        for name in alike:
            stage = now["stages"][name]
            stage["seconds"] = min(stage["seconds"], then["stages"][name]["seconds"])
        if "whole_s" in now and len(alike) == len(now["stages"]):
            now["whole_s"] = min(now["whole_s"], then["whole_s"])


class Pair:
    """Two volumes of ``shape``, and the stages of their correlation, ready to be measured."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.shape = shape
        self.predictor = flow(window_grid(shape, *SETTINGS.passes[0]), shape)
        self.volumes = particles(shape, self.predictor)
        self.plan = room(shape, SETTINGS, None)
        self.stages = dict(work.correlation(shape, SETTINGS, self.plan.voxels))
        self.seconds = dict.fromkeys(self.stages, float("inf"))
        self.whole_s = float("inf")

    def measure(self) -> None:
        """Each stage of all passes once more, and the whole."""
        pair = correlation.DevicePair(*self.volumes, None, self.plan)
        seconds = dict.fromkeys(self.stages, 0.0)
        grids = [window_grid(self.shape, *each) for each in SETTINGS.passes]
        for number, grid in enumerate([*grids, sample_of(grids[-1])], 1):
            last = number == len(grids)
            batches = WindowPass(grid, self.predictor if number > 1 else None, SETTINGS, 0.25, self.shape)
            planes_s, windows_s = parts(pair, batches, scatter=last)
            seconds["deformation"] += planes_s
            seconds["last windows" if last else "windows"] += windows_s
            if number == 1:
                first = self.predictor.at(*grid.centres)
                seconds["offset"] = best(lambda grid=grid, first=first: pair.offset(grid, first), times=2)
        for name, once in seconds.items():
            self.seconds[name] = min(self.seconds[name], once)
        self.whole_s = min(self.whole_s, best(lambda: correlation.measure(*self.volumes, SETTINGS), times=1))

    def described(self) -> dict[str, Any]:
        """The best seconds, each stage's beside its work."""
        stages = {name: {"seconds": self.seconds[name], **vars(stage)} for name, stage in self.stages.items()}
        return {"shape": list(self.shape), "voxels": self.plan.voxels, "whole_s": self.whole_s, "stages": stages}


def parts(pair: Any, batches: WindowPass, scatter: bool) -> tuple[float, float]:
    """Seconds of a pass for its planes, and for its windows: what both take less what planes alone do, so that windows
    find each layer's planes where a pass leaves them, not in a cache."""
    import jax

    grid, how = batches.windows, How.of(batches, scatter)
    filters = tuple(jax.numpy.asarray(each) for each in batches.correlator.filters)
    powers = jax.numpy.asarray(batches.correlator.powers, jax.numpy.float32)

    def layers() -> Any:
        about = batches.predictor, grid.size[0], grid.step[0]
        a, b = (Deformed(each, about[0], s, *about[1:]) for each, s in zip(pair.both, (-0.5, 0.5), strict=True))
        return ((a.layer(start), b.layer(start)) for start in grid.starts[0].tolist())

    def planes() -> Any:
        for held in layers():  # noqa: B007  the next layer takes the memory of the one before
            pass
        return held

    def windows() -> Any:
        return [pair.layer(batches, layer, held, filters, powers, how) for layer, held in enumerate(layers())]

    planes_s = best(planes, times=2)
    return planes_s, max(best(windows, times=2) - planes_s, 0.1 * planes_s)


def particles(shape: tuple[int, int, int], moved: SplineField) -> tuple[DenseVolume, DenseVolume]:
    """Two volumes of particles, six in a window, displaced by whole voxels."""
    rng, (z, y, x) = np.random.default_rng(0), (np.arange(n) for n in shape)
    at = rng.integers(0, shape, (int(6 * np.prod(shape) / 16 / 32 / 32), 3))
    d = np.rint(moved.at(z, y, x)).astype(int)[::-1, *at.T].T  # z, y, x
    grid, out = VoxelGrid((0.0,) * 3, (1.0,) * 3, shape), []
    for where in (at - d // 2, at - d // 2 + d):
        light = np.zeros(shape, np.float32)
        np.add.at(light, tuple(np.clip(where, 0, np.array(shape) - 1).T), 20.0)
        out.append(DenseVolume(grid, gaussian_filter(light, 1.0)))
    return out[0], out[1]


def flow(grid: Any, shape: tuple[int, int, int]) -> SplineField:
    """A smooth displacement of up to two voxels."""
    z, y, x = (np.sin(2 * c / n) for c, n in zip(np.meshgrid(*grid.centres, indexing="ij"), shape, strict=True))
    return fit_spline(np.stack([2 * y, -2 * x, z]), grid.centres, shape)


def work_of(stage: Mapping[str, float]) -> work.Work:
    return work.Work(stage["moved"], stage["operations"], stage["calls"])


def share(rates: Rates, stage: Mapping[str, float]) -> float:
    """What a stage reaches of bandwidth or rate, whichever limits it."""
    least = max(stage["moved"] / rates.bandwidth, stage["operations"] / rates.operations)
    return least / max(stage["seconds"] - stage["calls"] * rates.call_s, 0.1 * stage["seconds"])


def tell(result: Mapping[str, Any]) -> None:
    rates = result["rates"]
    print(f"{rates['bandwidth'] / 1e9:.1f} GB/s, {rates['operations'] / 1e9:.0f} Gop/s, {rates['call_s'] * 1e6:.0f} us")
    for each in [*result["pairs"], *result["frames"]]:
        whole = f"  whole {each['whole_s']:.2f} s" if "whole_s" in each else ""
        print(" x ".join(map(str, each["shape"])) + whole)
        for name, stage in each["stages"].items():
            ratio, of_bandwidth = stage["predicted_s"] / stage["seconds"], 100 * stage["share_of_bandwidth"]
            print(
                f"  {name:<12} {stage['seconds']:8.3f} s, predicted {stage['predicted_s']:8.3f} s ({ratio:.2f}), "
                f"{of_bandwidth:.0f} % of bandwidth"
            )


if __name__ == "__main__":
    try:
        main()
    except PlenoPIVError as error:
        sys.exit(f"device.py: {error}")
