"""HDF5 files on a full disk: one line that names the file, though the library would crash."""

import resource
import subprocess
import sys

import pytest

PROGRAM = """
import resource, signal, sys
from pathlib import Path
import numpy as np, xarray
from plenopiv.errors import PlenoPIVError
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.series_file import write_series
from plenopiv.io.volumes import write_volume
from plenopiv.io.vtkhdf import write_vtkhdf
from plenopiv.volume import SparseVolume, VoxelGrid

folder, rng, shape = Path(sys.argv[1]), np.random.default_rng(0), (1, 10, 20, 20)
axes = {"time": [0.5], "z": np.arange(10.0), "y": np.arange(20.0), "x": np.arange(20.0)}
names = ("u", "v", "w", "valid")
field = xarray.Dataset({n: (tuple(axes), rng.normal(size=shape).astype(np.float32)) for n in names}, axes)
write_velocity(folder / "pair.nc", field)
grid = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), shape[1:])
volume = SparseVolume.from_mask(grid, rng.random(shape[1:]) < 0.5)
volume.values[:] = rng.random(volume.values.size)
pairs = {k: folder / "pair.nc" for k in (0, 1)}
writers = {
    "velocity.nc": lambda path: write_velocity(path, field),
    "series.nc": lambda path: write_series(path, field, {"time": [0.0, 1.0]}, pairs, {}),
    "volume.h5": lambda path: write_volume(path, volume),
    "field.vtkhdf": lambda path: write_vtkhdf(path, field),
}
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for name, write in writers.items():
    write(folder / name)
    size = (folder / name).stat().st_size
    (folder / name).unlink()
    for share in (0.0, 0.002, 0.1, 0.6, 0.999):
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(share * size), resource.RLIM_INFINITY))
        try:
            write(folder / name)
        except PlenoPIVError as error:
            assert str(error) == f"{folder / name}: cannot be written (File too large)", error
        else:
            raise AssertionError(f"{name} was written within {share} of its size")
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    write(folder / name)
print("all refused")
"""


LIMITED = pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="no limit of a file's size")


def all_refused(program, folder):
    """Run a program of its own on a folder: the limits that it sets would be this process' too."""
    command = [sys.executable, "-c", program, str(folder)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "all refused\n", "")


@LIMITED
def test_files_that_grow_too_large_are_refused_by_name(tmp_path):
    all_refused(PROGRAM, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "field.vtkhdf",
        "pair.nc",
        "series.nc",
        "velocity.nc",
        "volume.h5",
    ]


SIMULATED = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from plenopiv.errors import PlenoPIVError
from plenopiv.io import OutputFolder
from plenopiv.simulation.simulated_recording import write_folder

folder, rng = Path(sys.argv[1]), np.random.default_rng(0)
images = {"white": rng.integers(0, 4000, (200, 200)).astype(np.uint16)}
truth = {"truth_particles": {"a": rng.random((2000, 3))}}
texts = {"experiment.toml": "a" * 5000}


def staged(out):
    with OutputFolder(out, overwrite=True) as made:
        made.write_bytes("design.png", rng.bytes(60_000))


signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for write, name in (
    (lambda out: write_folder(out, images, {}, {}), "white.tif"),
    (lambda out: write_folder(out, {}, truth, {}), "truth_particles.npz"),
    (lambda out: write_folder(out, {}, {}, texts), "experiment.toml"),
    (staged, "design.png"),
):
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, resource.RLIM_INFINITY))
    out = folder / name.replace(".", "-")
    try:
        write(out)
    except PlenoPIVError as error:
        assert str(error).startswith(f"{out / name}: cannot be written ("), error
    else:
        raise AssertionError(f"{name} was written")
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert not out.exists() or not list(out.iterdir()), list(out.iterdir())
    write(out)
    assert [path.name for path in out.iterdir()] == [name]
print("all refused")
"""


@LIMITED
def test_recordings_and_designs_on_a_full_disk(tmp_path):
    """A line that names the file, and nothing left behind that fills the disk."""
    all_refused(SIMULATED, tmp_path)
