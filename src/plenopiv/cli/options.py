"""Options of the command line that say where pairs are measured, and on what."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

WorkerCount = Annotated[
    int | None,
    typer.Option("--workers", metavar="N", min=1, help="Measure pairs in N processes on this machine (Dask)."),
]
ThreadsOfEach = Annotated[
    int | None, typer.Option("--threads", metavar="T", min=1, help="Of each worker; default: cores divided by N.")
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Measure pairs on the workers of a Dask scheduler.")
]
SchedulerFile = Annotated[
    Path | None,
    typer.Option("--scheduler-file", metavar="FILE", help="The same, by the file that the scheduler writes."),
]
Device = Annotated[
    str | None,
    typer.Option("--device", metavar="KIND", help="cpu, gpu, or auto, a GPU where there is one; else as in the file."),
]
