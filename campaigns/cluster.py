"""Two workers against one, and runs whose workers and scheduler are killed:  cluster.py

Twenty pairs of the small camera (benchmarks/accuracy/small_recording.py), simulated under build/cluster. Workers are
killed at random moments, a few in each run, and once the scheduler, after which the same command goes on; each time the
results are compared, byte by byte, with those of a run without Dask, but for times, memory and hashes of files that
hold these. Then runs of 200 pairs with one and two workers of one thread take turns, so that what else the machine
does falls on both: a start of Dask and a report take ten seconds whatever the workers. What two cores of the machine
give at most is measured by two runs without Dask at once against one alone. Writes
campaigns/results/cluster.json after each run, and goes on where it was stopped; what is recorded for other
sources is measured again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

import psutil
from numba_versions import sources_hash

ROOT = Path(__file__).parents[1]
BUILD, RESULTS = ROOT / "build" / "cluster", ROOT / "campaigns" / "results" / "cluster.json"
PAIRS, KILLS = 20, 20
PAIRS_OF_SPEED, REPEATS = 200, 1
BETWEEN_S = 6.0, 14.0  # kills
VARYING = ("summary.json", "report.html", "manifest.jsonl")
TIMES = ("timings_s", "peak_memory_gb", "memory_estimate_gb", "time_estimate_s", "machine_speed")
COMMAND = [sys.executable, "-c", "import sys; from plenopiv.cli import main; sys.exit(main(sys.argv[1:]))", "run", "-q"]
ONE, TWO = ["--workers", "1", "--threads", "1"], ["--workers", "2", "--threads", "1"]


def recording(name: str, pairs: int) -> Path:
    sys.path.insert(0, str(ROOT / "benchmarks" / "accuracy"))
    from small_recording import clean_recording

    return clean_recording(BUILD / name, pairs).folder


def started(folder: Path, options: list[str]) -> subprocess.Popen:
    return subprocess.Popen([*COMMAND, str(folder / "experiment.toml"), *options], stdout=subprocess.DEVNULL)


def timed(folder: Path, options: list[str]) -> dict[str, float]:
    """Seconds of a whole run, and of its pairs alone, from nothing to results."""
    shutil.rmtree(folder / "results", ignore_errors=True)
    begin, load = time.perf_counter(), os.getloadavg()[0]
    assert started(folder, options).wait() == 0
    whole = time.perf_counter() - begin
    summary = json.loads((folder / "results" / "summary.json").read_text())
    pairs = summary["timings_s"]["pairs on workers"]
    return {"whole_s": round(whole, 2), "pairs_s": round(pairs, 2), "load_before": round(load, 2)}


def of_the_machine(folder: Path) -> dict[str, float]:
    """Seconds of a run of one thread without Dask, alone and beside another one: what two cores give at most."""
    one, two = folder, folder.with_name(folder.name + "-2")
    if not two.exists():
        shutil.copytree(one, two)
    seconds = []
    for folders in ([one], [one, two]):
        for each in folders:
            shutil.rmtree(each / "results", ignore_errors=True)
        begin, single = time.perf_counter(), os.environ | {"NUMBA_NUM_THREADS": "1"}
        runs = [subprocess.Popen([*COMMAND, str(f / "experiment.toml")], env=single) for f in folders]
        assert [run.wait() for run in runs] == [0] * len(runs)
        seconds.append(round(time.perf_counter() - begin, 2))
    return {"alone_s": seconds[0], "both_s": seconds[1]}


def contents(folder: Path) -> dict[str, object]:
    """Files of the results but for times and memory, and lines of the manifest but for hashes of those."""
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    lines = [json.loads(line) for line in found["manifest.jsonl"].decode().splitlines()]
    kept = [{k: v for k, v in each.items() if k != "check"} for each in lines if each.get("file") not in VARYING]
    summary = {k: v for k, v in json.loads(found["summary.json"]).items() if k not in TIMES}
    return {k: v for k, v in found.items() if k not in VARYING} | {"manifest.jsonl": kept, "summary.json": summary}


def scheduler_of(run: subprocess.Popen) -> psutil.Process | None:
    """Dask's process that a run on this machine started, once it is there."""
    try:
        held = [p for p in psutil.Process(run.pid).children() if "local_cluster" in " ".join(p.cmdline())]
    except psutil.Error:
        return None
    return held[0] if held else None


def kill_a_worker(run: subprocess.Popen, rng: random.Random) -> bool:
    try:
        workers = [p for p in scheduler_of(run).children() if "spawn_main" in " ".join(p.cmdline())]
        rng.choice(workers).kill()
    except (psutil.Error, AttributeError, IndexError):
        return False
    return True


def with_kills(folder: Path, undisturbed: dict[str, object], rng: random.Random, most: int) -> dict[str, object]:
    """A run of which a worker is killed every few seconds."""
    shutil.rmtree(folder / "results", ignore_errors=True)
    run, kills, after = started(folder, TWO), 0, time.monotonic() + rng.uniform(*BETWEEN_S)
    while run.poll() is None:
        if time.monotonic() > after and kills < most:
            kills += kill_a_worker(run, rng)
            after = time.monotonic() + rng.uniform(*BETWEEN_S)
        time.sleep(0.05)
    return {"kills": kills, "exit_code": run.returncode, "identical": contents(folder / "results") == undisturbed}


def with_scheduler_killed(folder: Path, undisturbed: dict[str, object]) -> dict[str, object]:
    """A run of which the scheduler is killed when a third is done, and the same command once more."""
    shutil.rmtree(folder / "results", ignore_errors=True)
    run, stored = started(folder, TWO), folder / "results" / ".plenopiv" / "pairs"
    while len(list(stored.glob("*.json"))) < PAIRS // 3 and run.poll() is None:
        time.sleep(0.05)
    scheduler_of(run).kill()
    first, kept = run.wait(), len(list(stored.glob("*.json")))
    second = started(folder, TWO).wait()
    identical = contents(folder / "results") == undisturbed
    return {"exit_codes": [first, second], "pairs_kept": kept, "identical": identical}


def main() -> None:
    """Run what is not recorded yet; exit 1 where results differ."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    state = {"sources": sources_hash(), "pairs": PAIRS}
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if {key: found.get(key) for key in state} != state:
        found = state | {"worker_kills": []}
    if found.get("pairs_of_speed") != PAIRS_OF_SPEED:
        found |= {"pairs_of_speed": PAIRS_OF_SPEED, "speed": []}

    def record() -> None:
        RESULTS.parent.mkdir(exist_ok=True)
        RESULTS.write_text(json.dumps(found, indent=2) + "\n")

    folder = recording("recording", PAIRS)
    alone = folder.with_name("alone")
    if not (alone / "results" / "summary.json").exists():
        shutil.copytree(folder, alone, dirs_exist_ok=True)
    assert started(alone, []).wait() == 0  # makes it, or finds it whole and of these sources' version
    undisturbed = contents(alone / "results")
    rng = random.Random(len(found["worker_kills"]))
    while (done := sum(each["kills"] for each in found["worker_kills"])) < KILLS:
        found["worker_kills"].append(with_kills(folder, undisturbed, rng, KILLS - done))
        record()
    if "scheduler_kill" not in found:
        found["scheduler_kill"] = with_scheduler_killed(folder, undisturbed)
        record()
    if "machine" not in found:
        found["machine"] = seconds = of_the_machine(folder)
        found["speed_up_of_machine"] = round(2 * seconds["alone_s"] / seconds["both_s"], 3)
        record()
    longer = recording("longer", PAIRS_OF_SPEED)
    while len(found["speed"]) < REPEATS:
        turns = ("one", ONE), ("two", TWO)
        both = {name: timed(longer, options) for name, options in turns[:: (-1) ** len(found["speed"])]}
        found["speed"].append(both)
        for part in ("whole_s", "pairs_s"):
            ratios = [each["one"][part] / each["two"][part] for each in found["speed"]]
            found[f"speed_up_of_{part.removesuffix('_s')}"] = round(statistics.median(ratios), 3)
        record()
    same = [each["identical"] for each in (*found["worker_kills"], found["scheduler_kill"])]
    print(json.dumps({key: value for key, value in found.items() if key.startswith("speed_up")}), f"{sum(same)} same")
    sys.exit(not all(same))


if __name__ == "__main__":
    main()
