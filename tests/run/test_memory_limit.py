"""What a run is allowed to take."""

import json

import pytest

from plenopiv.cameras.presets import preset
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.run.memory import BASE, HELD, KEPT, LAYER, REPORT, MemoryEstimate, estimate, tiles_within
from plenopiv.volume import VoxelGrid


def test_within():
    MemoryEstimate(images=1e8, light_field=1e9, volumes=2e9).keep_within(1.0 * (BASE + 3.1e9))


def test_larger_voxels_would_fit():
    needed = MemoryEstimate(images=1e8, light_field=1e9, volumes=8e9)
    with pytest.raises(PlenoPIVError, match=r"takes about 9\.36 GB.* voxels 2\.00 times .* or 12\.5 % of the volume"):
        needed.keep_within(BASE + 2.1e9 + 1)


def test_no_voxels_would_fit():
    with pytest.raises(PlenoPIVError, match="for anything but voxels"):
        MemoryEstimate(images=1e8, light_field=1e9, volumes=1e9).keep_within(1e9)
    with pytest.raises(PlenoPIVError, match=r"0\.43 GB of it for anything but voxels"):
        MemoryEstimate(images=0.0, light_field=5e7, volumes=3e8).keep_within(0.4e9)  # the report needs more
    with pytest.raises(PlenoPIVError, match="for anything but voxels"):
        MemoryEstimate(images=0.0, light_field=0.0, volumes=0.0).keep_within(REPORT / 2)


def test_what_correlation_takes_grows_with_planes_and_deepest_windows():
    grid = VoxelGrid.covering((-10, 10), (-10, 10), (-1, 1), (0.02, 0.02, 0.1))
    twenty = 1000 * 1000 * 4 * 20.0  # bytes of as many planes, all that there are
    assert estimate(preset("29mp"), grid, deepest=10).layers == (1 + HELD[0]) * LAYER * twenty / 2
    assert estimate(preset("29mp"), grid).layers == (1 + HELD[0]) * LAYER * twenty
    fine = VoxelGrid.covering((-10, 10), (-10, 10), (-1, 1), (0.005, 0.005, 0.1))  # large arrays are given back
    assert estimate(preset("29mp"), fine).layers == LAYER * 16 * twenty + HELD[1]
    few = MemoryEstimate(images=0.0, light_field=0.0, volumes=0.0, layers=twenty)
    assert few.peak == REPORT + twenty
    with pytest.raises(PlenoPIVError, match="for anything but voxels"):
        few.keep_within(REPORT + twenty / 2)


def test_as_few_tiles_as_keep_within():
    needed = MemoryEstimate(images=1e8, light_field=1e9, volumes=8e9)
    else_ = BASE + 1.1e9
    assert tiles_within(needed, else_ + 8e9, 1000, 100) == [(0, 1000, 0, 1000)]
    halves = tiles_within(needed, else_ + 5.3e9, 1000, 100)  # of 550 rows, and what is kept
    assert [t.high - t.low for t in halves] == [550, 550]
    assert needed.in_tiles(0.55).peak == pytest.approx(else_ + (0.55 + KEPT) * 8e9)
    thirds = tiles_within(needed, else_ + 4.4e9, 1000, 100)
    assert len(thirds) == 3
    assert max(t.high - t.low for t in thirds) <= 435
    with pytest.raises(PlenoPIVError, match="would fit"):
        tiles_within(needed, else_ + 1e9, 1000, 100)


def test_a_run_in_tiles(experiment, capsys, monkeypatch):
    monkeypatch.setattr("plenopiv.run.memory.LISTED", 1e9 / (8.0 * experiment.grid().size))  # a volume of 1 GB
    monkeypatch.setattr(
        "plenopiv.projection.plenoptic.projector.PlenopticProjector.passage", 4
    )  # light crosses half of so small a one
    assert main(["run", str(experiment.path), "--memory", "1.1"]) == 0
    assert "the volume is reconstructed in" in capsys.readouterr().err
    result = json.loads((experiment.output_directory / "summary.json").read_text())
    assert result["tiles"] > 1
    assert result["memory_estimate_gb"] <= 1.1


def test_a_run_that_takes_more_does_not_begin(experiment, capsys):
    assert main(["run", str(experiment.path), "--memory", "0.1"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("plenopiv: error: memory: this run takes about")
    assert not experiment.output_directory.exists()
