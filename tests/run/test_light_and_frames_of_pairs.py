"""Light that the volume does not explain, and frames that have nothing in common: known once they are measured."""

import shutil
import tomllib

import numpy as np
import pytest
import tifffile
import tomli_w

import plenopiv
from plenopiv.checks import common, explained
from plenopiv.errors import PlenoPIVError

pytestmark = pytest.mark.usefixtures("without_report")


@pytest.fixture
def folder(three_pairs, tmp_path):
    """Two of the pairs."""
    shutil.copytree(three_pairs, tmp_path / "run", ignore=shutil.ignore_patterns("p3_*"))
    changed(tmp_path / "run", "reconstruction", iterations=3)
    return tmp_path / "run"


def changed(folder, table, **keys):
    """An experiment with some keys of one table stated otherwise."""
    path = folder / "experiment.toml"
    tables = tomllib.loads(path.read_text())
    tables[table] |= keys
    path.write_text(tomli_w.dumps(tables))
    return plenopiv.load(path)


@pytest.mark.full
def test_nothing_is_said_of_good_pairs(folder):
    summary = plenopiv.process(plenopiv.load(folder / "experiment.toml")).summary
    assert (summary["findings"], summary["set_aside"]) == ([], [])
    shares = [frame["unexplained_share"] for frame in summary["reconstruction"].values()]
    assert 0.1 < min(shares) <= max(shares) < 0.35


@pytest.mark.full
def test_a_volume_cut_in_depth(folder):
    changed(folder, "recording", pairs=[["p1_a.tif", "p1_b.tif"]])
    with pytest.warns(plenopiv.PlenoPIVWarning, match=r"of the light's contrast in p1_a.tif is not that of particles"):
        result = plenopiv.process(changed(folder, "volume", z_mm=[-0.8, 0.8]))
    (found,) = [one for one in result.summary["findings"] if one["name"] == "unexplained-light"]
    assert 45 < found["number"] < 80
    assert "volume.z_mm" in found["advice"]
    assert result.velocity.attrs["quality"] == "doubtful"


@pytest.mark.full
def test_a_volume_smaller_than_the_field_of_view_is_no_fault(folder):
    settings = changed(folder, "volume", x_mm=[-0.45, 0.45], y_mm=[-0.45, 0.45])
    windows = settings.correlation.model_copy(update={"windows": ((32, 32, 16),)})
    summary = plenopiv.process(settings.model_copy(update={"correlation": windows})).summary
    assert "unexplained-light" not in [one["name"] for one in summary["findings"]]


@pytest.mark.full
def test_frames_of_two_pairs_are_set_aside(folder):
    shutil.copy(folder / "p1_b.tif", folder / "p2_b.tif")
    image = tifffile.imread(folder / "p2_b.tif").astype(float)
    noisy = np.rint(image + np.random.default_rng(1).normal(0, 2, image.shape)).clip(0, 4095)
    tifffile.imwrite(folder / "p2_b.tif", noisy.astype(np.uint16))
    with pytest.warns(plenopiv.PlenoPIVWarning, match="p2_a.tif and p2_b.tif have nothing in common"):
        result = plenopiv.process(plenopiv.load(folder / "experiment.toml"))
    assert [one["pair"] for one in result.summary["set_aside"]] == [1]
    assert result.velocity.u.notnull().any(("z", "y", "x")).values.tolist() == [True, False]


@pytest.mark.full
def test_no_pair_is_left(folder):
    changed(folder, "recording", pairs=[["p1_a.tif", "p2_b.tif"]])
    with pytest.raises(PlenoPIVError, match=r"no pair can be measured: p1_a.tif and p2_b.tif have nothing in common"):
        plenopiv.process(plenopiv.load(folder / "experiment.toml"))
    assert not (folder / "results").exists()
    forced = plenopiv.process(plenopiv.load(folder / "experiment.toml"), force=True)
    assert forced.summary["quality"] == "forced"


def field(replaced, ratio):
    import xarray

    valid = np.arange(100) >= replaced
    names = {"u": np.ones(100), "valid": valid.astype(np.uint8), "peak_ratio": np.full(100, ratio)}
    return xarray.Dataset({name: (("time", "z", "y", "x"), v.reshape(1, 1, 10, 10)) for name, v in names.items()})


@pytest.mark.parametrize(
    ("replaced", "ratio", "severity"),
    [
        (20, 1.5, None),
        (30, 1.5, "warning"),
        (30, 1.3, "unusable"),
        (30, 4.0, None),
        (60, 1.5, "unusable"),
        (60, 4.0, "warning"),
    ],
)
def test_how_many_replaced_vectors_are_too_many(replaced, ratio, severity):
    found = common.finding(field(replaced, ratio), ("a.tif", "b.tif"))
    assert (found and found.severity) == severity


def test_the_share_from_which_light_is_unexplained():
    assert explained.finding(None, "a.tif") is None
    assert explained.finding(0.35, "a.tif") is None
    assert explained.finding(0.45, "a.tif").severity == "warning"
