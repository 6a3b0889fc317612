"""Options that several commands share: where pairs are measured, and on what; parts of a period."""

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
Bins = Annotated[
    int | None,  # more parts than degrees would be a mistake, and each holds sums of the whole field
    typer.Option("--bins", metavar="N", min=1, max=360, help="Parts of the period, with --phase; default: 8."),
]
Period = Annotated[
    float | None,
    typer.Option("--period", metavar="P", help="Period in the unit of the phases, with --phase; default: 360."),
]
