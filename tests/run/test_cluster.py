"""Pairs measured by Dask's workers: the same bits, whoever dies."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tifffile
import tomli_w
from conftest import record

import plenopiv
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.run import local_cluster, workers
from plenopiv.run.share import limit_of_worker
from plenopiv.run.workers import Workers

pytestmark = pytest.mark.usefixtures("without_report")
psutil, distributed = pytest.importorskip("psutil"), pytest.importorskip("distributed")

PAIRS = 4
COMMAND = [sys.executable, "-c", "import sys; from plenopiv.cli import main; sys.exit(main(sys.argv[1:]))"]
VARYING = ("summary.json", "report.html", "manifest.jsonl")


@pytest.fixture(scope="module")
def recorded_pairs(tmp_path_factory):
    """Pairs p0_a.tif, p0_b.tif ... that differ by their noise, measured quickly."""
    folder = tmp_path_factory.mktemp("cluster") / "recording"
    made = record(folder.with_name("made"), rays=2000).directory
    folder.mkdir()
    rng = np.random.default_rng(0)
    for k in range(PAIRS):
        for pulse in "ab":
            image = tifffile.imread(made / f"{pulse}.tif").astype(float)
            noisy = np.clip(np.rint(image + rng.normal(0, 2, image.shape)), 0, 4095).astype(np.uint16)
            tifffile.imwrite(folder / f"p{k}_{pulse}.tif", noisy)
    shutil.copy(made / "white.tif", folder)
    tables = tomllib.loads((made / "experiment.toml").read_text())
    del tables["recording"]["frames"]
    tables["recording"]["pairs"] = "p*_{a,b}.tif"
    tables["reconstruction"]["iterations"] = 2
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    return folder


@pytest.fixture
def folder(recorded_pairs, tmp_path):
    shutil.copytree(recorded_pairs, tmp_path / "run")
    return tmp_path / "run"


def as_sequence(folder):
    """The same frames as a sequence, each moved against the one before."""
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["recording"].pop("pairs")
    tables["recording"]["frames"] = "p*.tif"
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))


def files(folder):
    """Contents of the results but for times and memory, and hashes of files that hold some."""
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
    lines = found["manifest.jsonl"].decode().splitlines()
    records = [{k: v for k, v in json.loads(line).items() if k != "check"} for line in lines]
    summary = json.loads(found["summary.json"])
    for key in ("timings_s", "peak_memory_gb", "memory_estimate_gb", "time_estimate_s"):
        del summary[key]
    summary.pop("machine_speed", None)  # there is none where other machines compute
    out = {name: content for name, content in found.items() if name not in VARYING}
    out["summary.json"] = summary
    return out | {"manifest.jsonl": [each for each in records if each.get("file") not in VARYING]}


@pytest.fixture
def watched(tmp_path, monkeypatch):
    """Have workers load ``killing``; what frames they reconstructed."""
    log = tmp_path / "reconstructed.txt"
    log.touch()
    monkeypatch.setenv("TEST_LOG", str(log))
    monkeypatch.setenv("DASK_DISTRIBUTED__WORKER__PRELOAD", json.dumps([str(Path(__file__).with_name("killing.py"))]))
    return lambda: log.read_text().splitlines()


@pytest.fixture(scope="module")
def in_turn(recorded_pairs, tmp_path_factory):
    """Results of a run without Dask."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    shutil.copytree(recorded_pairs, folder)
    with pytest.MonkeyPatch.context() as patch:
        from runs import without_report

        without_report(patch)
        plenopiv.process(Experiment.load(folder / "experiment.toml"))
    return files(folder / "results")


def children():
    return {child.pid for child in psutil.Process().children(recursive=True)}


@pytest.mark.full
@pytest.mark.parametrize("count", [1, 2])
def test_workers_give_the_same_bits(folder, in_turn, count, capfd, monkeypatch):
    before = children()
    monkeypatch.chdir(folder.parent)
    assert main(["run", "run/experiment.toml", "--workers", str(count), "--threads", "1"]) == 0  # relative paths too
    assert files(folder / "results") == in_turn
    assert not children() - before
    assert sorted(path.name for path in folder.parent.iterdir()) == ["run"]  # no files of Dask's
    err = capfd.readouterr().err
    assert all(line.startswith("plenopiv: ") for line in err.splitlines()), err
    assert "of each worker" in err


@pytest.mark.full
def test_a_sequence_s_frames_are_reconstructed_once(folder, watched):
    as_sequence(folder)
    result = plenopiv.process(Experiment.load(folder / "experiment.toml"), workers=2, force=True)
    assert result.summary["pairs"] == 2 * PAIRS - 1
    assert not result.summary["set_aside"]
    assert sorted(watched()) == sorted(f"p{k}_{pulse}.tif" for k in range(PAIRS) for pulse in "ab")


@pytest.mark.full
def test_a_frame_that_kills_its_workers_does_not_stop_the_rest(folder, in_turn, watched, monkeypatch, capfd):
    experiment = folder / "experiment.toml"
    monkeypatch.setenv("TEST_KILLS", "p1_b.tif")
    monkeypatch.setenv("TEST_HUNGRY", "p3_a.tif")
    assert main(["run", str(experiment), "--workers", "2"]) == 3
    captured = capfd.readouterr()
    assert "2 of 4 pairs set aside" in captured.out
    assert "p1_b.tif: its worker died 3 times" in captured.out
    assert "not enough memory on a worker (so says the test)" in captured.out
    assert all(line.startswith("plenopiv: ") for line in captured.err.splitlines()), captured.err
    monkeypatch.delenv("TEST_KILLS")
    monkeypatch.delenv("TEST_HUNGRY")
    first = len(watched())
    assert main(["run", str(experiment), "--workers", "2"]) == 0
    assert sorted(watched()[first:]) == ["p1_a.tif", "p1_b.tif", "p3_a.tif", "p3_b.tif"]
    assert files(folder / "results") == in_turn


def started(*words, wait_for=None, **variables):
    """A process of its own, and what follows when ``wait_for`` is there."""
    process = subprocess.Popen(
        [*COMMAND, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | variables,
    )
    until = time.monotonic() + 120
    while wait_for is not None and not wait_for() and process.poll() is None:
        assert time.monotonic() < until
        time.sleep(0.02)
    return process


def helper_of(process):
    """Dask's process that a run started, and its workers."""
    (helper,) = (p for p in psutil.Process(process.pid).children() if "local_cluster" in " ".join(p.cmdline()))
    return helper, [p for p in helper.children() if "spawn_main" in " ".join(p.cmdline())]


@pytest.mark.full
def test_a_killed_worker_costs_what_it_had_in_work(folder, in_turn, watched):
    run = started("run", folder / "experiment.toml", "--workers", "2", wait_for=lambda: len(watched()) > 2)
    helper_of(run)[1][0].kill()
    _, err = run.communicate(timeout=300)
    assert run.returncode == 0, err
    assert all(line.startswith("plenopiv: ") for line in err.splitlines()), err
    figures_aside = {name: content for name, content in files(folder / "results").items() if "figures" not in name}
    for name in in_turn:
        if name.endswith(".nc"):
            assert figures_aside[name] == in_turn[name], name


@pytest.mark.full
def test_workers_that_are_killed_while_they_start_come_back(tmp_path):
    command, given = local_cluster.command(2, 1, None, tmp_path), local_cluster.environment(1)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with subprocess.Popen(command, env=os.environ | given, **pipes) as helper:
        address, process = helper.stdout.readline().strip(), psutil.Process(helper.pid)
        with distributed.Client(address, set_as_default=False) as client:
            for _ in range(8):
                for child in process.children():
                    if "spawn_main" in " ".join(child.cmdline()):
                        child.kill()
                time.sleep(0.4)
            until = time.monotonic() + 120
            while len(client.nthreads()) < 2:
                assert time.monotonic() < until
                time.sleep(0.1)
        started_last = process.children(recursive=True)
        helper.stdin.close()
        assert helper.wait(timeout=10) == 0
        assert not psutil.wait_procs(started_last, timeout=10)[1]


@pytest.mark.full
@pytest.mark.parametrize("end", ["scheduler", "interrupt", "terminate", "kill"])
def test_what_is_finished_is_kept(folder, watched, end):
    """The scheduler dies, or the run is stopped: no process stays, and the same command goes on."""

    def stored():
        return list((folder / "results" / ".plenopiv" / "pairs").glob("*.json"))

    run = started("run", folder / "experiment.toml", "--workers", "1", wait_for=stored)
    helper, of_helper = helper_of(run)
    {
        "scheduler": helper.kill,
        "interrupt": lambda: run.send_signal(signal.SIGINT),
        "terminate": run.terminate,
        "kill": run.kill,
    }[end]()
    _, err = run.communicate(timeout=60)
    assert run.returncode == {"scheduler": 2, "interrupt": 130, "terminate": 143, "kill": -9}[end], err
    if end == "scheduler":
        assert "the Dask scheduler is gone" in err
    assert all(line.startswith("plenopiv: ") for line in err.splitlines()), err
    psutil.wait_procs([helper, *of_helper], timeout=10)
    assert not any(p.is_running() and p.status() != psutil.STATUS_ZOMBIE for p in [helper, *of_helper])
    work, kept = folder / "results" / ".plenopiv", len(stored())
    names = {path.name for path in work.rglob("*")}
    assert not any(name.endswith(".part") for name in names) or end == "kill", names
    done = len(watched())
    again = plenopiv.process(Experiment.load(folder / "experiment.toml"), workers=1)
    assert len(watched()) - done <= 2 * (PAIRS - kept)
    assert again.summary["pairs"] == PAIRS
    assert not work.exists()


@pytest.mark.full
def test_a_scheduler_and_a_worker_in_other_processes(folder, in_turn, tmp_path, capfd):
    file, dask = tmp_path / "scheduler.json", [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    scheduler = subprocess.Popen([*dask, *options], **quiet)
    worker = None
    try:
        while not file.exists():
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        of_worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "2", "--no-dashboard"]
        # Dask's profiler holds frames of Python for a moment, so HDF5 may lay out the same contents in another order.
        alone = os.environ | {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}
        worker = subprocess.Popen([*of_worker, "--local-directory", str(tmp_path / "dask")], **quiet, env=alone)
        assert main(["run", str(folder / "experiment.toml"), "--scheduler", address]) == 0
        assert files(folder / "results") == in_turn
        shutil.rmtree(folder / "results")
        assert main(["run", str(folder / "experiment.toml"), "--scheduler-file", str(file), "--pairs", "1-2"]) == 0
        assert sorted(path.name for path in (folder / "results" / ".plenopiv" / "pairs").glob("*.nc")) == [
            "pair-0001.nc",
            "pair-0002.nc",
        ]
    finally:
        for process in (worker, scheduler):
            if process is not None:
                process.terminate()
                process.wait(timeout=30)
    err = capfd.readouterr().err
    assert all(line.startswith("plenopiv: ") for line in err.splitlines()), err


def test_without_dask_one_line_says_what_to_install(folder, monkeypatch, capsys):
    monkeypatch.setattr(workers, "find_spec", lambda name: None)
    assert main(["run", str(folder / "experiment.toml"), "--workers", "2"]) == 2
    assert 'need Dask: pip install "plenopiv[cluster]"' in capsys.readouterr().err
    assert not (folder / "results").exists()


def test_a_scheduler_that_does_not_answer(folder, monkeypatch, capfd):
    monkeypatch.setattr(workers, "PATIENCE_S", 0.3)
    assert main(["run", str(folder / "experiment.toml"), "--scheduler", "tcp://127.0.0.1:9"]) == 2
    (line,) = capfd.readouterr().err.splitlines()[-1:]
    assert line.startswith("plenopiv: error: tcp://127.0.0.1:9: no Dask scheduler answers there")
    assert not (folder / "results").exists()


@pytest.mark.parametrize("content", ["", "{}", "[]", '{"type": "Sched', '{"address": 5}'])
def test_a_scheduler_s_file_that_names_none(tmp_path, monkeypatch, content):
    monkeypatch.setattr(workers, "PATIENCE_S", 0.3)
    (tmp_path / "s.json").write_text(content)
    with (
        pytest.raises(PlenoPIVError, match=r"s\.json: names no scheduler, or is half written; dask scheduler"),
        workers.started(Workers(scheduler_file=tmp_path / "s.json")),
    ):
        pass


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--threads", "2"], "name one of --workers, --scheduler and --scheduler-file"),
        (["--workers", "2", "--scheduler", "tcp://a:1"], "name one of --workers, --scheduler and --scheduler-file"),
        (["--workers", "0"], "--workers"),
    ],
)
def test_options_that_do_not_go_together(folder, options, words, capsys):
    assert main(["run", str(folder / "experiment.toml"), *options]) == 2
    assert words in capsys.readouterr().err


def test_threads_and_memory_of_workers():
    assert local_cluster.settings(1, folder="/scratch")["temporary-directory"] == "/scratch"
    assert "temporary-directory" not in local_cluster.settings(1)
    assert local_cluster.settings(3)["distributed.nanny.pre-spawn-environ"] == {
        "NUMBA_NUM_THREADS": "3",
        "OMP_NUM_THREADS": "3",
        "OPENBLAS_NUM_THREADS": "3",
        "MKL_NUM_THREADS": "3",
    }
    assert Workers(64).threads_of_each == 1
    assert Workers(scheduler="tcp://a:1").threads_of_each is None
    assert limit_of_worker(4, None) is None
    assert limit_of_worker(4, float("inf")) is None  # as without workers: a run may take all that there is
    assert 4 * limit_of_worker(4, 8.0) < 1.1 * 8e9
    with pytest.raises(PlenoPIVError, match="1 and more"):
        Workers(count=0)
