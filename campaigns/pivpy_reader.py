"""pivpy and OpenPIV read what plenopiv export writes for them:  pivpy_reader.py

Both are under the GPL: they are installed into an environment of their own, build/pivpy, and never imported by the
program or its tests. A field with replaced and missing vectors is written; their own readers must find the same
numbers, the measured vectors valid and no others, and pivpy's accessors must leave the component along z as it is.
Writes campaigns/results/pivpy.json: versions, and what was compared.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import venv
from importlib.metadata import version
from pathlib import Path

import numpy as np
import xarray

ROOT = Path(__file__).parents[1]
ENVIRONMENT = ROOT / "build" / "pivpy"
RESULTS = ROOT / "campaigns" / "results" / "pivpy.json"
PEER = "pivpy==0.4.0"
SHAPE = (2, 3, 12, 15)  # time, z, y, x
Z_MM = 0.5


def field() -> xarray.Dataset:
    """As ``plenopiv.io.read_velocity`` gives it, with digits to the last bit; some replaced, some missing."""
    rng = np.random.default_rng(5)
    dims = ("time", "z", "y", "x")
    components = {name: (dims, rng.normal(size=SHAPE), {"units": "m s-1"}) for name in ("u", "v", "w")}
    errors = {f"{name}_std": (dims, rng.random(SHAPE), {"units": "m s-1"}) for name in ("u", "v", "w")}
    valid = (rng.random(SHAPE) > 0.1).astype(np.int8)
    axes = {"time": [0.001, 0.101], "z": [0.0, 0.5, 1.0], "y": 0.25 * np.arange(12) - 1, "x": 0.5 * np.arange(15) - 3}
    made = xarray.Dataset({**components, **errors, "valid": (dims, valid)}, axes, {"dt_s": 0.001, "frame": "camera"})
    seen = xarray.DataArray(rng.random(SHAPE) > 0.05, dims=dims)
    return made.where(seen).assign(valid=made.valid.where(seen, 0))


def python_of_the_peer() -> Path:
    """In an environment that holds pivpy; OpenPIV comes with it."""
    python = ENVIRONMENT / "bin" / "python"
    if not python.exists():
        venv.create(ENVIRONMENT, with_pip=True)
    if subprocess.run([python, "-c", "import pivpy, openpiv"], stderr=subprocess.DEVNULL).returncode:
        subprocess.run([python, "-m", "pip", "install", "--quiet", PEER], check=True)
    return python


def read_by_the_peer(folder: Path) -> None:
    """In the peer's environment: what its readers make of ``folder``, into read.npz and read.json there."""
    import openpiv.tools
    import pivpy.io
    from matplotlib import use

    use("Agg")
    plane = pivpy.io.read_piv(str(folder / "plane.nc"))
    held = {name: plane[name].transpose("t", "y", "x").values for name in ("u", "v", "chc")}
    held |= {axis: plane[axis].values for axis in "xyt"}
    whole = xarray.load_dataset(folder / "plane.nc", engine="h5netcdf")
    before = whole.velocity_z.copy(deep=True)
    turned = whole.piv.vorticity()
    curl = whole.v.differentiate("x") - whole.u.differentiate("y")
    said = {
        "versions": {name: version(name) for name in ("pivpy", "openpiv", "xarray", "numpy")},
        "delta_t": plane.attrs["delta_t"],
        "velocity_z is as it was": bool(before.equals(turned.velocity_z)),
        "vorticity is in w": bool(turned.w.equals(curl)),
    }
    shown = openpiv.tools.display_vector_field(str(folder / "plane.txt"), show_invalid=True)
    drawn = [arrows.N for arrows in shown[1].collections]
    said["arrows that OpenPIV draws, valid and replaced"] = drawn
    text = pivpy.io.read_piv(str(folder / "plane.txt"))
    said["vectors of OpenPIV's text that pivpy calls valid"] = int((text.chc > 0).sum())
    np.savez(folder / "read.npz", **held)
    (folder / "read.json").write_text(json.dumps(said))


def main() -> None:
    """Write, have it read, compare."""
    from plenopiv.cli import main as plenopiv
    from plenopiv.io import write_velocity

    given = field()
    plane = given.sel(z=Z_MM)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_velocity(folder / "velocity.nc", given)
        for target in ("plane.nc", "plane.txt"):
            if plenopiv(["export", str(folder / "velocity.nc"), str(folder / target), "--z", str(Z_MM)]):
                raise SystemExit(1)
        subprocess.run([python_of_the_peer(), __file__, "--read", folder], check=True, cwd=folder)
        read, said = np.load(folder / "read.npz"), json.loads((folder / "read.json").read_text())
        for component in "uv":
            np.testing.assert_array_equal(read[component], plane[component].values)
        for axis, there in {"x": "x", "y": "y", "time": "t"}.items():
            np.testing.assert_array_equal(read[there], given[axis].values)
    measured = (plane.valid == 1).values & plane.u.notnull().values
    np.testing.assert_array_equal(read["chc"], measured)
    first, missing = measured[0], plane.u.isnull().values[0]
    assert said["velocity_z is as it was"]
    assert said["vorticity is in w"]
    assert said["arrows that OpenPIV draws, valid and replaced"] == [int(first.sum()), int((~first).sum())]
    counts = {"vectors": first.size, "measured": int(first.sum()), "missing": int(missing.sum())}
    said["of the first time"] = counts
    RESULTS.write_text(json.dumps(said, indent=1) + "\n")
    print(RESULTS.read_text())


if __name__ == "__main__":
    read_by_the_peer(Path(sys.argv[2])) if "--read" in sys.argv else main()
