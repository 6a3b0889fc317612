"""A calibrated lattice in its file."""

import math
import tomllib
from dataclasses import replace

import pytest

from plenopiv.calibration import LatticeFit, load_lattice, save_lattice
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice, LatticeMap

FIT = LatticeFit(
    lattice=Lattice("hexagonal", 0.1 / 3.0, -1.0 / 7.0, (1e-7 / 3.0, -0.02)),
    image_pitch_px=14.043,
    residual_px=0.0115,
    worst_px=0.03,
    residual_map_px=((0.001, 0.002), (0.003, 1e-5)),
    stretch=-1e-7,
    shear_rad=2e-6,
    microlenses=13839,
    rejected=3,
)
BY = LatticeMap(2, 1.0 / 3.0, ((1e-7, -0.1 / 7.0), (0.0, 2e-5), (1e-3, 0.0), (0.0, 1e-9), (-3e-4, 0.25)))
MAPPED = LatticeFit(**{**FIT.__dict__, "lattice": replace(FIT.lattice, map=BY), "stretch_std": 1e-6 / 3.0})


@pytest.mark.parametrize("fit", [FIT, MAPPED], ids=["regular", "mapped"])
def test_round_trip_is_exact(tmp_path, fit):
    path = tmp_path / "lattice.toml"
    save_lattice(fit, path)
    assert load_lattice(path) == fit
    assert [p.name for p in tmp_path.iterdir()] == ["lattice.toml"]


def test_unmeasured_region_survives(tmp_path):
    path = tmp_path / "lattice.toml"
    save_lattice(LatticeFit(**{**FIT.__dict__, "residual_map_px": ((math.nan, 0.5),)}), path)
    ((first, second),) = load_lattice(path).residual_map_px
    assert math.isnan(first)
    assert second == 0.5


def test_files_without_deviations_still_load(tmp_path):
    path = tmp_path / "lattice.toml"
    save_lattice(FIT, path)
    path.write_text("".join(line for line in path.read_text().splitlines(True) if "_std" not in line))
    assert load_lattice(path) == FIT


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("degree = 2", "degree = 3", "lattice.map.coefficients_mm"),
        ("degree = 2", "degree = 2.5", "lattice.map.degree"),
        ("unit_mm = 0.3", "unit_mm = -0.3", "lattice.map.unit_mm"),
        ("[1e-07, ", "[", "lattice.map.coefficients_mm"),
        ("[1e-07, ", "[nan, ", "lattice.map.coefficients_mm"),
    ],
)
def test_corrupted_map(tmp_path, old, new, message):
    path = tmp_path / "lattice.toml"
    save_lattice(MAPPED, path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(PlenoPIVError, match=rf"lattice\.toml: {message} is missing.*plenopiv calibrate"):
        load_lattice(path)


def test_keys_name_their_units(tmp_path):
    path = tmp_path / "lattice.toml"
    save_lattice(FIT, path)
    data = tomllib.loads(path.read_text())
    assert data["lattice"]["pitch_mm"] == FIT.lattice.pitch_mm
    assert data["fit"]["residual_px"] == FIT.residual_px
    assert "-8.185111 degrees" in path.read_text()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "hexagonal"', 'kind = "round"', "lattice.kind"),
        ("pitch_mm = 0.03", "pitch_mm = -0.03", "lattice.pitch_mm"),
        ("pitch_mm = 0.03", "pich_mm = 0.03", "lattice.pitch_mm"),
        ("rotation_rad = -", "rotation_rad = nan  # ", "lattice.rotation_rad"),
        ("offset_mm = [", "offset_mm = [1.0, ", "lattice.offset_mm"),
        ("microlenses = 13839", 'microlenses = "many"', "fit.microlenses"),
        ("rejected = 3", "rejected = true", "fit.rejected"),
        ("[fit]", "[fid]", "fit.residual_map_px"),
        ("[0.001, 0.002]", "[0.001]", "fit.residual_map_px"),
        ("[lattice]", "[lattice", "is no lattice file"),
    ],
)
def test_corrupted_file(tmp_path, old, new, message):
    path = tmp_path / "lattice.toml"
    save_lattice(FIT, path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(PlenoPIVError, match=rf"lattice\.toml: .*{message}.*plenopiv calibrate"):
        load_lattice(path)


def test_truncated_binary_missing(tmp_path):
    path = tmp_path / "lattice.toml"
    save_lattice(FIT, path)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(PlenoPIVError, match="plenopiv calibrate"):
        load_lattice(path)
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(PlenoPIVError, match="is no lattice file"):
        load_lattice(path)
    with pytest.raises(PlenoPIVError, match="cannot be read"):
        load_lattice(tmp_path / "absent.toml")
    with pytest.raises(PlenoPIVError, match="cannot be written"):
        save_lattice(FIT, tmp_path / "absent" / "lattice.toml")
