"""The resolved file in a results folder finds the images, whatever letters the folders between have."""

import sys
import tomllib

import pytest
from test_experiment_file import changed

from plenopiv.experiment import Experiment
from plenopiv.recording.pairs import pairs, sequence


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such names")
@pytest.mark.parametrize("folder", ["r[1]", "r*", "r?", "[r]", "r7"])
@pytest.mark.parametrize("directory", ["results", "../out1", "../../r[1]"])
@pytest.mark.parametrize("pattern", ["[ab].tif", "*.tif", "x/{a,b}.tif", "x/*{a,b}.tif", "absolute"])
def test_patterns_match_the_same_files_from_the_results(tmp_path, folder, directory, pattern):
    run = tmp_path / "disk" / folder
    (run / "x").mkdir(parents=True)
    for name in ("a.tif", "b.tif", "x/a.tif", "x/b.tif"):
        (run / name).touch()
    (tmp_path / "disk" / "r1").mkdir()  # which r[1], r* and r? match as patterns
    (tmp_path / "disk" / "r1" / "c.tif").touch()
    pattern = str(tmp_path / "disk" / "r[1]" / "*.tif") if pattern == "absolute" else pattern
    key, find = ("pairs", pairs) if "{" in pattern else ("frames", sequence)
    tables = changed("recording.frames", None) | {"output": {"directory": directory}}
    tables["recording"][key] = pattern
    experiment = Experiment.from_dict(tables, run / "experiment.toml")
    results = experiment.output_directory
    results.mkdir(parents=True, exist_ok=True)
    moved = tomllib.loads(experiment.dump_toml(results))["recording"][key]
    files = []
    for at, stated in ((run, pattern), (results, moved)):
        found = find(at, stated)
        files.append([frame.path.resolve() for frame in (found[0] if key == "pairs" else found)])
    assert files[0] == files[1]
