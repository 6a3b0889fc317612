"""The job script of the Slurm example, as text; nothing is submitted."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "slurm_cluster.py"


@pytest.fixture(scope="module")
def script():
    pytest.importorskip("dask_jobqueue")
    specification = importlib.util.spec_from_file_location("slurm_cluster", EXAMPLE)
    example = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(example)
    with example.cluster(16, "64GB", "04:00:00", queue="compute", account="piv") as jobs:
        return jobs.job_script()


def test_the_job_asks_slurm_for_what_was_given(script):
    assert script.startswith("#!/usr/bin/env bash\n")
    asked = re.findall(r"^#SBATCH (.*)$", script, re.MULTILINE)
    wanted = {"-J plenopiv", "-p compute", "-A piv", "-n 1", "--cpus-per-task=16", "-t 04:00:00", "--mem=60G"}
    assert wanted <= set(asked)


def test_the_job_is_one_worker_with_all_its_threads(script):
    for name in ("NUMBA", "OMP", "OPENBLAS", "MKL"):
        assert f"export {name}_NUM_THREADS=16\n" in script
    command = script.strip().splitlines()[-1]
    assert f"{sys.executable} -m distributed.cli.dask_worker tcp://" in command
    assert "--nthreads 16 " in command
    assert "--memory-limit 59.60GiB" in command
    assert "--nanny" in command
    assert "--death-timeout 120" in command
    assert "--nworkers" not in command


@pytest.mark.full
def test_it_is_printed_without_slurm():
    said = subprocess.run([sys.executable, EXAMPLE, "--show"], capture_output=True, text=True, timeout=120, check=True)
    assert "#SBATCH --cpus-per-task=8" in said.stdout
    assert said.stderr == ""
