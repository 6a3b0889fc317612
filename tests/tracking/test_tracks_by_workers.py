"""Pairs tracked by Dask's workers: the same bits as one after the other."""

import shutil
import tomllib

import numpy as np
import pytest
import tifffile
import tomli_w
import xarray
from uniform_recording import simulated

from plenopiv.cli import main

pytest.importorskip("distributed")
pytestmark = pytest.mark.full  # a recording is simulated, and tracked twice


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """Three pairs, of one recording with more noise: the second frame of the last one shows nothing."""
    folder = tmp_path_factory.mktemp("pairs") / "recording"
    made = folder.with_name("made")
    simulated(made)
    folder.mkdir()
    rng = np.random.default_rng(0)
    for k in range(3):
        for pulse in "ab":
            image = tifffile.imread(made / f"{pulse}.tif").astype(float)
            noisy = np.clip(np.rint(image + rng.normal(0, 2, image.shape)), 0, 4095)
            dark = 60 + rng.normal(0, 2, image.shape)
            counts = dark if (k, pulse) == (2, "b") else noisy
            tifffile.imwrite(folder / f"p{k}_{pulse}.tif", np.rint(counts).astype(np.uint16))
    for name in ("white.tif", "experiment.toml", "optics.json"):
        shutil.copy(made / name, folder)
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    del tables["recording"]["frames"]
    tables["recording"]["pairs"] = "p*_{a,b}.tif"
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    return folder


@pytest.mark.parametrize("count", [1, 2])
def test_workers_give_the_same_tracks(pairs, tmp_path, count):
    results = []
    for name, options in (("alone", []), ("spread", ["--workers", str(count)])):
        shutil.copytree(pairs, tmp_path / name)
        assert main(["--quiet", "track", str(tmp_path / name / "experiment.toml"), *options]) == 3  # a pair set aside
        folder = tmp_path / name / "results"
        results.append([xarray.load_dataset(folder / file) for file in ("tracks.nc", "tracking/velocity.nc")])
        results[-1].append(sorted(p.name for p in (folder / "tracking" / "pairs").iterdir()))
    (tracks, field, files), (tracks_of_workers, field_of_workers, files_of_workers) = results
    assert tracks.equals(tracks_of_workers)
    assert field.equals(field_of_workers)
    assert files == files_of_workers
    assert (tracks.track_id.values >= 0).sum() > 100


def test_frames_of_a_sequence_are_not_spread(pairs, tmp_path, capsys):
    shutil.copytree(pairs, tmp_path / "run")
    path = tmp_path / "run" / "experiment.toml"
    tables = tomllib.loads(path.read_text()) | {"tracking": {"method": "multi-frame"}}
    path.write_text(tomli_w.dumps(tables))
    assert main(["track", str(path), "--workers", "2"]) == 2
    assert "takes one frame after the other" in capsys.readouterr().err
