"""Every script of examples/ runs, on one small recording, and what it says of itself is true."""

import ast
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from plenopiv.io import read_velocity, write_velocity

pytestmark = pytest.mark.full

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = sorted(path.name for path in EXAMPLES.glob("*.py"))


def ran(name, *arguments):
    """What a script leaves in its variables."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name, *map(str, arguments)])
        return runpy.run_path(str(EXAMPLES / name), run_name="__main__")


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """The folder that the first script fills, smaller than it would by itself."""
    folder = tmp_path_factory.mktemp("examples") / "ring"
    left = ran("vortex_ring.py", folder, "--columns", 460, "--rows", 440)
    assert (folder / "vortex_ring.png").stat().st_size > 10_000
    assert left["score"].vectors > 0
    assert max(left["score"].final_at_point.rms if left["score"].final_at_point else left["score"].final.rms) < 0.5
    return folder


def files(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_stage_by_stage_ends_where_a_run_does(ring, capsys):
    ran("stage_by_stage.py", ring)
    by_hand, run = (read_velocity(ring / name) for name in ("stage_by_stage.nc", "results/velocity.nc"))
    for name in run.data_vars:
        np.testing.assert_array_equal(by_hand[name].values, run[name].values, err_msg=name)
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[:4]] == [
        "recording",
        "calibration",
        "light",
        "reconstruction",
    ]


def test_vorticity_of_the_ring(ring, capsys):
    """The ring's vorticity is about y in the plane through its axis, of one sign on each side."""
    left = ran("vorticity.py", ring)
    assert "vorticity along y" in capsys.readouterr().out
    field, about_y = left["field"], left["omega"][1, :, left["j"], :]
    nearer, farther = field.z.values > 0.5, field.z.values < -0.5
    assert about_y[nearer].mean() < 0  # about +x: where z > 0 the filament runs toward -y
    assert about_y[farther].mean() > 0
    inside = left["std"][:, 1:-1, 1:-1, 1:-1]
    assert inside.size == 0 or (np.isfinite(inside).all() and (inside > 0).all())


@pytest.mark.parametrize("name", ["views_and_refocusing.py", "other_programs.py"])
def test_it_writes_what_it_says(ring, name, capsys):
    before = files(ring)
    ran(name, ring)
    said = ast.get_docstring(ast.parse((EXAMPLES / name).read_text()))
    written = set(re.findall(r"FOLDER/([\w.]+\.(?:png|vtkhdf|txt|csv))", said))
    assert written
    assert files(ring) - before == written
    assert capsys.readouterr().out


def test_other_programs_are_given_a_plane_of_a_thin_recording(ring, tmp_path, capsys):
    velocity = read_velocity(ring / "results" / "velocity.nc")
    (tmp_path / "results").mkdir()
    write_velocity(tmp_path / "results" / "velocity.nc", velocity.assign_coords(z=0.01 * velocity.z))
    ran("other_programs.py", tmp_path)
    middle = float(0.01 * velocity.z[velocity.sizes["z"] // 2])
    assert f"at z = {middle:g} mm" in capsys.readouterr().out


@pytest.mark.parametrize("name", NAMES)
def test_each_says_how_to_call_it_and_is_listed(name):
    text = (EXAMPLES / name).read_text()
    assert f"python examples/{name} [FOLDER]" in ast.get_docstring(ast.parse(text))
    assert len(text.splitlines()) <= 80
    assert f"examples/{name}" in (EXAMPLES.parent / "docs" / "index.md").read_text()
