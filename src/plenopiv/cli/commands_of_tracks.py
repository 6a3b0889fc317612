"""Commands on particles and tracks: more of ``cli.app``, which they join when ``plenopiv.cli`` is imported."""

from __future__ import annotations

from plenopiv.cli.app import ExperimentFile, Force, Overwrite, _finish
from plenopiv.cli.commands_of_results import app
from plenopiv.cli.options import Scheduler, SchedulerFile, ThreadsOfEach, WorkerCount


@app.command()
def track(
    experiment: ExperimentFile,
    overwrite: Overwrite = False,
    workers: WorkerCount = None,
    threads: ThreadsOfEach = None,
    scheduler: Scheduler = None,
    scheduler_file: SchedulerFile = None,
    force: Force = False,
) -> None:
    """Track particles: positions from raw pixels with an error bar each, links between the frames of a pair, a field.

    Frames are reconstructed and correlated as by plenopiv run. Particles begin at the peaks of the volume and are
    fitted to the raw pixels, all that share pixels together; others are looked for in the light that is left. Links
    follow the correlation's displacement. Writes tracks.nc into the output folder: x, y, z in mm, u, v, w in m/s,
    standard deviations, covariance, light, frame and track_id of each particle (obs); and tracking/velocity.nc, splines
    through the links, free of divergence.

    With tracking.method = "multi-frame" the particles of a sequence's later frames begin where their tracks predict
    them, without a reconstruction; positions, velocities and accelerations (ax, ay, az in m/s^2) are those of smooth
    tracks.

    A recording that plenopiv check calls unusable is refused, unless --force is given, as by plenopiv run.

    Finished pairs are kept, whatever ends it: the same command goes on from there. A pair that cannot be tracked is set
    aside, and the exit code is 3. Pairs may be tracked by several processes, here (--workers) or on a cluster; those of
    a sequence that is tracked over many frames may not.

    \b
    Example:
        plenopiv track run7/experiment.toml
        plenopiv track run7/experiment.toml --workers 4
        python -c "import xarray; print(xarray.open_dataset('run7/results/tracks.nc'))"
    """
    from plenopiv.cli.track import track

    _finish("track", track(experiment, overwrite, (workers, threads, scheduler, scheduler_file), force))
