"""What a run is allowed to take: against what runs took, byte counts by hand, and advice that is followed."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from plenopiv.cameras.presets import preset
from plenopiv.cli import main
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.run.memory import MemoryEstimate, estimate, of_settings, tiles_within
from plenopiv.volume import VoxelGrid

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS / "accuracy"))
from conditions import CONDITIONS  # noqa: E402

TAKEN = json.loads((BENCHMARKS / "speed" / "memory.json").read_text())  # voxels, GB announced then, GB measured


@pytest.mark.parametrize("name", TAKEN)
def test_what_is_announced_is_what_runs_took(name):
    """Peaks of runs of docs/accuracy.md, each measured in a process of its own, up to 764 million voxels."""
    condition = CONDITIONS[name]
    grid = VoxelGrid.covering(*condition.volume_mm(), condition.voxel_mm())
    voxels, _, taken_gb = TAKEN[name]
    assert grid.size == voxels
    # with sub-windows, the default, runs took no more at once
    settings = CorrelationSettings(windows=condition.windows, inner_window=condition.windows[-1])
    announced = of_settings(condition.camera(), grid, ReconstructionSettings(), settings).peak
    assert 1.0 < announced / (1e9 * taken_gb) < 1.2


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not tell a process' peak")
def test_a_small_run_takes_what_it_announces(finished):
    """Nearly all of it interpreter and libraries; 0.1 GB more where its process compiled the kernels."""
    announced, taken = finished.summary["memory_estimate_gb"], max(finished.summary["peak_memory_gb"].values())
    assert announced - 0.15 < taken < announced + 0.15
    assert f"memory: about {announced:.2g} GB" in finished.err


def test_a_program_without_data_takes_a_few_hundred_megabytes():
    assert 0.3e9 < MemoryEstimate(images=0.0, light_field=0.0, volumes=0.0).peak < 0.6e9
    assert 3.3e9 < MemoryEstimate(images=1e8, light_field=1e9, volumes=2.1e9).peak < 3.7e9


def test_within():
    needed = MemoryEstimate(images=1e8, light_field=1e9, volumes=2e9)
    needed.keep_within(1.001 * needed.peak)
    with pytest.raises(PlenoPIVError, match=f"takes about {needed.peak / 1e9:.2f} GB"):
        needed.keep_within(0.999 * needed.peak)


def test_larger_voxels_would_fit():
    """What is advised fits, and hardly less does not."""
    needed = MemoryEstimate(images=1e8, light_field=1e9, volumes=8e9)
    limit = 3.0e9
    with pytest.raises(PlenoPIVError, match=r"takes about 9\.\d\d GB, more than the 3\.00 GB allowed") as said:
        needed.keep_within(limit)
    larger, share = map(float, re.search(r"voxels (\S+) times .* or (\S+) % of the volume", str(said.value)).groups())
    for volumes in (needed.volumes / larger**3, needed.volumes * share / 100):
        replace(needed, volumes=volumes).keep_within(limit)
        with pytest.raises(PlenoPIVError):
            replace(needed, volumes=1.05 * volumes).keep_within(limit)


def test_no_voxels_would_fit():
    with pytest.raises(PlenoPIVError, match="for anything but voxels"):
        MemoryEstimate(images=1e8, light_field=1e9, volumes=1e9).keep_within(1e9)
    with pytest.raises(PlenoPIVError, match=r"0\.5\d GB of it for anything but voxels"):
        MemoryEstimate(images=0.0, light_field=5e7, volumes=3e8).keep_within(0.4e9)  # the report needs more
    with pytest.raises(PlenoPIVError, match="for anything but voxels"):
        MemoryEstimate(images=0.0, light_field=0.0, volumes=0.0).keep_within(0.2e9)


def test_what_correlation_takes_grows_with_planes_and_deepest_windows():
    """A plane of 1000 x 1000 voxels is 4 MB. A layer of windows holds its planes of both volumes, and makes the next
    one's from two sparse volumes meanwhile: two to six times its depth in planes."""
    plane = 4e6
    grid = VoxelGrid.covering((-10, 10), (-10, 10), (-1, 1), (0.02, 0.02, 0.1))
    assert grid.shape == (20, 1000, 1000)
    ten, sixteen, all_twenty = (estimate(preset("29mp"), grid, deepest=n).layers for n in (10, 16, 20))
    assert 2 * 10 * plane < ten < 6 * 10 * plane
    assert sixteen == pytest.approx(1.6 * ten)
    assert all_twenty == pytest.approx(2 * ten)
    assert estimate(preset("29mp"), grid, deepest=64).layers == all_twenty  # there are no more planes
    fine = VoxelGrid.covering((-10, 10), (-10, 10), (-1, 1), (0.005, 0.005, 0.1))
    sixteenfold = estimate(preset("29mp"), fine, deepest=20).layers
    assert 12 * all_twenty < sixteenfold < 16 * all_twenty  # large arrays are given back when they are free
    nothing = MemoryEstimate(images=0.0, light_field=0.0, volumes=0.0)
    few = replace(nothing, layers=all_twenty)
    assert few.peak == nothing.peak + all_twenty
    with pytest.raises(PlenoPIVError, match="for anything but voxels"):
        few.keep_within(nothing.peak + all_twenty / 2)


def test_as_few_tiles_as_keep_within():
    """1000 rows, of which the light of a pixel crosses 100: tiles take 50 more on a side that is cut."""
    needed = MemoryEstimate(images=1e8, light_field=1e9, volumes=8e9)
    others = replace(needed, volumes=0.0).peak
    assert others < needed.peak - 7.9e9
    assert tiles_within(needed, needed.peak, 1000, 100) == [(0, 1000, 0, 1000)]
    for limit in (others + 5.5e9, others + 4.2e9, others + 2.6e9):
        tiles = tiles_within(needed, limit, 1000, 100)
        assert [tile.first for tile in tiles[1:]] == [tile.end for tile in tiles[:-1]]
        largest = max(tile.high - tile.low for tile in tiles)
        # the largest at once, and what is kept of the whole volume: 2 to 3 % of its voxels, up to a tenth if denser
        assert others + 8e9 * (largest / 1000 + 0.02) < needed.in_tiles(largest / 1000).peak <= limit
        fewer = 1000 / (len(tiles) - 1) + 50 * (1 + (len(tiles) > 3))
        assert needed.in_tiles(min(fewer, 1000) / 1000).peak > limit
    halves = tiles_within(needed, others + 5.5e9, 1000, 100)
    assert [(tile.low, tile.high) for tile in halves] == [(0, 550), (450, 1000)]
    with pytest.raises(PlenoPIVError, match="would fit"):
        tiles_within(needed, others + 0.9e9, 1000, 100)


@pytest.mark.full
@pytest.mark.usefixtures("without_report")
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
    before = (experiment.output_directory / "velocity.nc").read_bytes()
    assert main(["run", str(experiment.path)]) == 2  # would mix volumes in tiles with whole ones
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"another number of tiles (tiles: was {result['tiles']}, is 1); give the same --memory" in said
    assert (experiment.output_directory / "velocity.nc").read_bytes() == before
    assert main(["run", str(experiment.path), "--memory", "1.1"]) == 0
    assert "nothing to do" in capsys.readouterr().err


def test_a_run_that_takes_more_does_not_begin(experiment, capsys):
    assert main(["run", str(experiment.path), "--memory", "0.1"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("plenopiv: error: memory: this run takes about")
    assert not experiment.output_directory.exists()
