"""Names of files that are no UTF-8, as Linux takes them from disks of old computers."""

import os
import tomllib
from pathlib import Path

import pytest
import tomli_w
import xarray

from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.netcdf import write_dataset
from plenopiv.run.track import stated_frames
from plenopiv.run.written import source

LATIN_1 = os.fsdecode(b"D\xfcse")


def test_attributes_name_them(recorded, tmp_path):
    experiment = Experiment.from_dict(tomllib.loads((recorded / "experiment.toml").read_text()), f"{LATIN_1}.toml")
    attributes = {"source": source(experiment), "frames": stated_frames([f"{LATIN_1}_1.tif", "b.tif"], [0, 1])}
    write_dataset(tmp_path / "a.nc", xarray.Dataset({"u": ("obs", [1.0])}, attrs=attributes), {})
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as found:
        assert found.source.endswith(", D?se.toml")
        assert found.frames == ["0: D?se_1.tif", "1: b.tif"]


@pytest.mark.skipif(os.name != "posix", reason="names are Unicode elsewhere")
@pytest.mark.parametrize(("directory", "stays"), [("results", True), ("../results", False)])
def test_a_folder_that_the_results_could_not_name_is_refused_before_all(recorded, tmp_path, directory, stays):
    tables = tomllib.loads((recorded / "experiment.toml").read_text())
    tables["output"] = {"directory": directory}
    tables["recording"]["white"] = str(recorded / "white.tif")
    tables["recording"]["frames"] = [str(recorded / f"{letter}.tif") for letter in "ab"]
    folder = Path(tmp_path / LATIN_1)
    folder.mkdir()
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    experiment = Experiment.load(folder / "experiment.toml")
    if stays:
        assert len(experiment.recording().frames) == 2
        assert experiment.dump_toml(experiment.output_directory).encode()
        return
    with pytest.raises(PlenoPIVError, match=r"no UTF-8 \(.*D\?se\); rename it, or take an output\.directory beside"):
        experiment.recording()
