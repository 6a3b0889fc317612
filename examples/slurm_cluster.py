"""A recording measured by the nodes of a Slurm cluster, which dask-jobqueue asks for.

    python examples/slurm_cluster.py [FOLDER] --jobs 4 --cores 8 --memory 32GB --walltime 02:00:00
    python examples/slurm_cluster.py [FOLDER] --show

FOLDER ("ring" by default, which examples/vortex_ring.py makes) holds an experiment.toml and lies, as this
Python does, where all nodes see it. Run it on a node that may submit jobs and may stay up; jobs may come and go while
it runs, and when it is stopped the same command goes on. With --show the job script is printed and nothing submitted.
Needs pip install "plenopiv[cluster]".
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dask_jobqueue import SLURMCluster
from distributed import Client

import plenopiv
from plenopiv.run.workers import Workers

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def cluster(cores, memory, walltime, queue=None, account=None):
    """A scheduler in this process; each job that it will submit is one worker with all cores of the job."""
    return SLURMCluster(
        cores=cores,
        processes=1,
        memory=memory,
        walltime=walltime,
        queue=queue,
        account=account,
        job_name="plenopiv",
        job_script_prologue=[f"export {name}={cores}" for name in THREADS],
        local_directory="${TMPDIR:-/tmp}",
        log_directory="slurm-logs",
        death_timeout=120,  # s without a scheduler, after which a job ends
        scheduler_options={"dashboard_address": ":0"},  # any port that is free
    )


def main():
    """Ask for jobs, measure, and say where the report is."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", nargs="?", type=Path, default=Path("ring"))
    options.add_argument("--jobs", type=int, default=4)
    options.add_argument("--cores", type=int, default=8)
    options.add_argument("--memory", default="32GB", help="of a job; plenopiv info says what a run takes")
    options.add_argument("--walltime", default="02:00:00")
    options.add_argument("--queue", help="Slurm's partition")
    options.add_argument("--account")
    options.add_argument("--show", action="store_true", help="print the job script alone")
    given = options.parse_args()
    with cluster(given.cores, given.memory, given.walltime, given.queue, given.account) as jobs:
        if given.show:
            print(jobs.job_script())
            return
        jobs.scale(jobs=given.jobs)  # or jobs.adapt(maximum_jobs=...)
        with Client(jobs, set_as_default=False) as client:
            experiment = plenopiv.load(given.folder / "experiment.toml")
            result = plenopiv.process(experiment, workers=Workers(client=client))
    print(result.directory / "report.html")


if __name__ == "__main__":
    main()
