"""The commands and their help. Each imports its body when it is called, so that ``--help`` loads nothing heavy."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from plenopiv.cli.options import Device, Scheduler, SchedulerFile, ThreadsOfEach, WorkerCount
from plenopiv.cli.terminal import Outcome, terminal

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)

ExperimentFile = Annotated[Path, typer.Argument(metavar="EXPERIMENT", help="The experiment file (.toml).")]
Frame = Annotated[str | None, typer.Argument(metavar="[FRAME]", help="Its file's name, or its number from 1.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is already there.")]
Force = Annotated[
    bool, typer.Option("--force", help="Measure what the checks call unusable; velocity.nc says quality = forced.")
]


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"plenopiv {version('plenopiv')}")
        raise typer.Exit


def _finish(command: str, outcome: Outcome | str) -> None:
    """Print the result of a command; leave with its exit code."""
    code = terminal.result(command, outcome)
    if code:
        raise typer.Exit(code)


@app.callback()
def plenopiv_command(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and leave.")
    ] = False,
    quiet: Annotated[  # this and the next are read before (terminal.take_flags), so that they may stand anywhere
        bool, typer.Option("--quiet", "-q", help="No progress and no notes; also after a command.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object a line on stdout, for programs; also after a command.")
    ] = False,
) -> None:
    """From raw images of one plenoptic camera to a 3D velocity field.

    A recording is a folder of images: one white image and two or more frames. One experiment file describes the
    camera and says what to do; lengths are in mm, times in s. From images to vectors:

    \b
        plenopiv init run7 optics.json       draft run7/experiment.toml, every key explained
        plenopiv info run7/experiment.toml   what this camera can see, and what the run will need
        plenopiv check run7/experiment.toml  is the recording good? in words, with advice
        plenopiv run run7/experiment.toml    velocity.nc, summary.json and report.html in run7/results

    No recording at hand? See the whole chain on a synthetic one, scored against the truth, in a minute or two:

    \b
        plenopiv demo

    Mistakes in the input end with one line and exit code 2; warnings are one line each and do not stop a run.
    """


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where the images are.")],
    sheet: Annotated[Path, typer.Argument(metavar="OPTICS_SHEET", help="What is known of the camera: JSON or TOML.")],
    overwrite: Overwrite = False,
) -> None:
    """Draft FOLDER/experiment.toml from a folder of images and an optics sheet.

    Names tell which is the white image (white*, calib*, flat*, *_white), the dark one (dark*, *_dark), that of static
    light, or one for each pulse (background*, bg*, static*), and which are double frames (_A/_B, a/b, _0/_1, _1/_2,
    LaserPulse0/1, frameA/frameB, first/second). Files of two pages and of double height hold pairs too; all else is a
    sequence, in natural order. It prints what was taken for what. Volume and voxels are suggested from the optics; each
    key is explained in the file. An optics sheet:

    \b
        {"main_lens": {"focal_length_mm": 50, "aperture_mm": 25, "magnification": -1},
         "microlens_array": {"lattice": "hexagonal", "pitch_mm": 0.077, "focal_length_mm": 0.308},
         "sensor": {"columns": 6600, "rows": 4400, "pixel_pitch_mm": 0.0055, "bits": 12, "black_level": 60},
         "recording": {"orientation": "upright", "dt_s": 0.0005},
         "seeding": {"depth_mm": [-4, 4]}}

    \b
    Example:
        plenopiv init run7 optics.json
    """
    from plenopiv.cli.init import init

    _finish("init", init(folder, sheet, overwrite))


@app.command()
def simulate(
    experiment: ExperimentFile,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where the recording goes.")],
    overwrite: Overwrite = False,
) -> None:
    """Make a synthetic recording of the camera in EXPERIMENT, with the truth beside it.

    The experiment file needs a [simulation] table that names a flow:

    \b
        [simulation]
        flow = "vortex-ring"
        parameters = { circulation_mm2_s = 1500.0, radius_mm = 2.0 }
        particles_per_microlens = 1.0

    \b
    Example:
        plenopiv simulate experiment.toml synthetic
        plenopiv run synthetic/experiment.toml
    """
    from plenopiv.cli.simulate import simulate

    _finish("simulate", simulate(experiment, folder, overwrite))


@app.command()
def calibrate(experiment: ExperimentFile, overwrite: Overwrite = False) -> None:
    """Find the microlenses in the white image, and the camera in images of a target; print and save both.

    A run does this by itself; calibrate first to see whether the images are good. The lattice goes into lattice.toml;
    its residual says how far micro-images lie from it: a few hundredths of a pixel are usual; with tenths, inspect the
    white image. With [calibration] in the experiment file, optics and pose of the camera go into calibration.toml, and
    calibration.png shows by depth, field and view how far dots lie off that had no part in the fit.

    \b
    Example:
        plenopiv calibrate run7/experiment.toml
    """
    from plenopiv.cli.calibrate import calibrate

    _finish("calibrate", calibrate(experiment, overwrite))


@app.command()
def check(
    experiment: ExperimentFile,
    every: Annotated[
        bool, typer.Option("--all", help="Read every frame, not a sample: as long as reading takes.")
    ] = False,
) -> None:
    """Is this recording good? Lattice, f-numbers, exposure, background, seeding, displacement, order of frames.

    Each finding is good, a warning, or "unusable" (exit code 2), with what to do about it; look/check.png beside the
    experiment file shows the images and curves behind the findings. It takes seconds, with 29 megapixels half a minute.

    \b
    Example:
        plenopiv check run7/experiment.toml
        plenopiv --json check run7/experiment.toml
    """
    from plenopiv.cli.light_field import check

    _finish("check", check(experiment, every))


@app.command()
def views(
    experiment: ExperimentFile,
    frame: Frame = None,
    across: Annotated[int, typer.Option(metavar="N", min=1, max=15, help="Views along the aperture's diameter.")] = 5,
) -> None:
    """Draw sub-aperture images: what the camera sees through different places of its main lens.

    Particles nearer to the camera or farther away are displaced from view to view. Writes look/views-FRAME.png beside
    the experiment file.

    \b
    Example:
        plenopiv views run7/experiment.toml
        plenopiv views run7/experiment.toml a.tif --across 9
    """
    from plenopiv.cli.light_field import views

    _finish("views", views(experiment, frame, across))


@app.command()
def refocus(
    experiment: ExperimentFile,
    frame: Frame = None,
    z: Annotated[
        list[float] | None, typer.Option("--z", metavar="MM", help="Depth in mm, + toward the camera; may be repeated.")
    ] = None,
) -> None:
    """Draw a frame refocused at one or several depths: all views shifted and added.

    Particles are sharp at their own depth. Without --z some depths of the volume are taken. Writes
    look/refocus-FRAME.png beside the experiment file.

    \b
    Example:
        plenopiv refocus run7/experiment.toml
        plenopiv refocus run7/experiment.toml --z -2 --z 0 --z 2
    """
    from plenopiv.cli.light_field import refocus

    _finish("refocus", refocus(experiment, z or (), frame))


@app.command()
def preview(experiment: ExperimentFile, device: Device = None) -> None:
    """Measure the middle of the field coarsely, in well under a minute once the kernels are compiled.

    The first two frames, wider voxels, fewer iterations: to see whether settings are near, not to measure. Writes the
    folder preview beside the experiment file, with velocity.nc, preview.png, report.html and the small recording that
    was used; results are not touched.

    \b
    Example:
        plenopiv preview run7/experiment.toml
    """
    from plenopiv.cli.light_field import preview

    _finish("preview", preview(experiment, device))


@app.command()
def run(
    experiment: ExperimentFile,
    overwrite: Overwrite = False,
    memory: Annotated[
        float | None,
        typer.Option(
            metavar="GB", min=0.0, help="Take no more memory than this: reconstruct in tiles, or do not begin."
        ),
    ] = None,
    force: Force = False,
    pairs: Annotated[
        str | None,
        typer.Option(
            metavar="FIRST-LAST", help="Measure these pairs alone, counted from 0; put together by a later run."
        ),
    ] = None,
    workers: WorkerCount = None,
    threads: ThreadsOfEach = None,
    scheduler: Scheduler = None,
    scheduler_file: SchedulerFile = None,
    device: Device = None,
) -> None:
    """From raw images to velocity: check, calibrate, reconstruct, correlate, report.

    A recording that plenopiv check calls unusable is refused. A pair that cannot be measured is set aside, and the exit
    code is 3. Writes velocity.nc (u, v, w in m/s on x, y, z in mm), summary.json, the resolved experiment file and
    report.html into the output folder, of a series a file for each pair too.

    Finished pairs are kept, whatever ends a run: the same command goes on from there, and measures again what is
    damaged. Results of other settings or images are not replaced without --overwrite.

    \b
    Example:
        plenopiv run run7/experiment.toml
        plenopiv run run7/experiment.toml --pairs 0-49
        plenopiv run run7/experiment.toml --workers 4
        python -c "import xarray; print(xarray.open_dataset('run7/results/velocity.nc'))"
    """
    from plenopiv.cli.run import run

    where = workers, threads, scheduler, scheduler_file
    _finish("run", run(experiment, overwrite, memory, force, pairs, where, device))


@app.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="An experiment file, results (.nc) or an image.")],
) -> None:
    """Print what a file holds. For an experiment: camera, field of view by depth, voxels, memory, warnings. For
    velocity.nc, tracks.nc or statistics.nc: how much of what, where, how fast. For an image: size and counts.

    \b
    Example:
        plenopiv info run7/experiment.toml
        plenopiv info run7/results/velocity.nc
        plenopiv info run7/dark.tif
    """
    from plenopiv.cli.info import info

    _finish("info", info(file))


@app.command()
def design(
    sheet: Annotated[
        str, typer.Argument(metavar="OPTICS_SHEET", help="JSON or TOML as for init, or pmr8, pmr14, pmr28, 29mp.")
    ],
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="Where design.json, .txt and .png go.")
    ] = None,
    depth: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LOW HIGH", help="Depth that is lit, mm; default: of the sheet."),
    ] = None,
    density: Annotated[
        list[float] | None, typer.Option(metavar="PPM", help="Particles per microlens to simulate; may be repeated.")
    ] = None,
    simulate: Annotated[bool, typer.Option(help="Simulate twins, which takes minutes, for errors and seeding.")] = True,
    compare: Annotated[bool, typer.Option("--compare", help="Simulate a twin of each variant too.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """What a camera will do, before it is built: resolution, field, dead zone, seeding, velocity errors.

    Geometry gives how far a point moves until another pixel is lit; a simulated twin of the camera, imaged,
    reconstructed and correlated, gives the expected error of displacements. Then what changes with PMR, pitch,
    magnification and lattice. A sheet's recording and dt_s are not needed.

    \b
    Example:
        plenopiv design optics.json design
        plenopiv design 29mp --no-simulate
        plenopiv design pmr14 --depth -2 2 --density 0.5 --density 1
    """
    from plenopiv.cli.design import design

    _finish("design", design(sheet, folder, depth, density or (), simulate, compare, overwrite))


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where everything goes.")] = Path("plenopiv-demo"),
    overwrite: Overwrite = False,
) -> None:
    """Simulate a small recording of a known flow, measure it, and score the result against the truth.

    \b
    Example:
        plenopiv demo
        plenopiv demo /tmp/demo --overwrite
    """
    from plenopiv.cli.demo import demo

    _finish("demo", demo(folder, overwrite))
