"""Time that compilation takes, and whether results depend on threads:  start_and_threads.py [--repeats N]

Runs `plenopiv demo` with an empty cache of kernels, then again and again with it, N times on one thread and N times
on two. Compilation is what Numba reports; results are compared bit for bit. Writes start_and_threads.json.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DEMO = """
import sys, time
from plenopiv.kernels.numba_internals import event
class Compilation(event.Listener):
    depth, begin, seconds = 0, 0.0, 0.0
    def on_start(self, started):
        self.begin = time.perf_counter() if self.depth == 0 else self.begin
        self.depth += 1
    def on_end(self, ended):
        self.depth -= 1
        self.seconds += time.perf_counter() - self.begin if self.depth == 0 else 0.0
compilation = Compilation()
event.register("numba:compile", compilation)
from plenopiv.cli.demo import demo
from pathlib import Path
demo(Path(sys.argv[1]), True)
print("compilation", compilation.seconds)
"""


def run(folder: Path, cache: Path, threads: int) -> tuple[float, float, str]:
    """Wall seconds, seconds of compilation, and a digest of all that velocity.nc holds."""
    import xarray

    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "NUMBA_NUM_THREADS": str(threads)}
    begin = time.perf_counter()
    command = [sys.executable, "-c", DEMO, str(folder)]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    wall = time.perf_counter() - begin
    digest = hashlib.sha256()
    with xarray.open_dataset(folder / "results" / "velocity.nc", engine="h5netcdf") as velocity:
        for name in sorted(velocity.data_vars):
            digest.update(velocity[name].values.tobytes())
    return wall, float(ended.stdout.split("compilation")[1]), digest.hexdigest()


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as scratch:
        folder, cache = Path(scratch) / "demo", Path(scratch) / "cache"
        first = run(folder, cache, 2)
        later = {threads: [run(folder, cache, threads) for _ in range(repeats)] for threads in (2, 1)}
    same = len({digest for runs in (later[1], later[2], [first]) for *_, digest in runs}) == 1
    compiled = max(seconds for runs in later.values() for _, seconds, _ in runs)
    print(f"first demo: {first[0]:.1f} s, of it {first[1]:.1f} s compilation")
    for threads, runs in later.items():
        print(f"later, {threads} threads: {min(wall for wall, *_ in runs):.1f} s, compilation at most {compiled:.1f} s")
    print(f"{repeats} runs on one thread and {repeats} on two: {'identical, bit for bit' if same else 'DIFFERENT'}")
    found = {
        "first": first[:2],
        "later": {threads: [run[:2] for run in runs] for threads, runs in later.items()},
        "identical": same,
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
