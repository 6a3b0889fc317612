"""Kills: a run of 20 pairs is killed at a moment drawn by chance, and again, until one comes to its end. Every third
folder keeps the volumes of its frames too (output.volumes = true).

At the end the results must be those of an undisturbed run, and what was computed twice at most what was in work.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from typing import Any

import numpy as np
from series_runs import SEED, Series

AGAIN = 0.85  # of the resumed runs are killed too
PUBLISHING = 0.3  # of the kills wait until all pairs are measured: the last seconds are the most delicate
STEPS, WITH_VOLUMES = 130, 210  # of the work on files then


def tried(series: Series, number: int) -> dict[str, Any]:
    """One folder: killed once or more, then ended. ``kills``: moments, s, and how many pairs were kept then."""
    rng, volumes = np.random.default_rng([SEED, 2, number]), number % 3 == 2
    series = series.with_volumes() if volumes else series
    series.clear()
    kills, again, why = [], [], []
    frames, pairs, shown, in_work, begun = [], [], 0, 0, False
    while not kills or rng.random() < AGAIN:
        kept = series.finished() if series.results.is_dir() else set()
        if rng.random() < PUBLISHING:
            ended, moment = _while_moving(series, int(rng.integers(1, WITH_VOLUMES if volumes else STEPS)))
        else:
            left = series.seconds * (1 - 0.6 * len(kept) / series.pairs)
            moment = float(rng.uniform(0, left))
            running = series.start()
            ended = running.wait(moment) or running.kill()
        if ended.status != -signal.SIGKILL:  # it was faster
            begun = True
            break
        finished = series.finished() if series.results.is_dir() else set()
        kills.append({"after_s": round(ended.seconds, 2), "at": moment, "kept": len(finished | kept)})
        again += [pair for pair in ended.pairs if pair in kept]
        frames, pairs, shown = frames + ended.frames, pairs + ended.pairs, shown + len(ended.shown)
        in_work += len(set(ended.pairs) - finished)
    if not begun:
        ended = series.run()
    frames, pairs, shown = frames + ended.frames, pairs + ended.pairs, shown + len(ended.shown)
    why += series.wrong(ended)
    if again:
        why.append(f"pairs {again} measured again, though they were kept")
    twice = {"frames": len(frames) - 2 * series.pairs, "pairs": len(pairs) - series.pairs}
    if twice["pairs"] > len(kills) or twice["frames"] > 2 * len(kills):
        why.append(f"more than one pair a kill was computed twice: {twice}")
    counted = {"kills": kills, "twice": twice, "for_pictures": shown, "in_work": in_work}
    return counted | {"volumes": volumes, "why": why}


def _while_moving(series: Series, step: int) -> tuple[Any, str]:
    """Killed at a step of the work on files once all is measured: writing the manifest, moving, removing."""

    def inside() -> None:
        from plenopiv.io.series_folder import SeriesFolder

        publish, count = SeriesFolder.publish, [0]

        def hook(event: str, given: tuple[Any, ...]) -> None:
            if event in ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir") and ".plenopiv" in str(given[0]):
                count[0] += 1
                if count[0] == step:
                    os.kill(os.getpid(), signal.SIGKILL)

        def published(*given: Any) -> Any:
            sys.addaudithook(hook)
            return publish(*given)

        SeriesFolder.publish = published  # type: ignore[method-assign]

    return series.run(inside), f"step {step} of publishing"


def free(series: Series) -> None:
    """Remove the folder of a series."""
    shutil.rmtree(series.folder, ignore_errors=True)
