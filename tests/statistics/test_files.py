"""``plenopiv statistics``: from velocity.nc, one time after the other, to statistics.nc and its figure."""

import json
import re

import h5netcdf
import numpy as np
import pytest
import xarray as xr

import plenopiv
from plenopiv.cli import main, statistics
from plenopiv.errors import PlenoPIVError
from plenopiv.io import series_statistics, write_velocity
from plenopiv.report.convergence import convergence_figure
from plenopiv.statistics import SeriesStatistics


@pytest.fixture
def results(tmp_path, field_of, monkeypatch):
    """Twelve pairs, one of them set aside."""
    monkeypatch.setattr("plenopiv.io.netcdf.damage", lambda path, netcdf: "")  # a child process takes 0.3 s
    monkeypatch.setattr(statistics, "_draw", lambda found, figures: [path.touch() for path in figures])  # 1.5 s
    rng = np.random.default_rng(0)
    fields = [field_of(rng.normal(2.0, 0.5, (3, 2, 3, 4)), 0.1, time=1e-3 * k) for k in range(12)]
    fields[4] = field_of(np.full((3, 2, 3, 4), np.nan), np.nan, np.zeros((2, 3, 4)), time=4e-3)
    folder = tmp_path / "results"
    folder.mkdir()
    write_velocity(folder / "velocity.nc", xr.concat(fields, "time"))
    return folder


def test_the_file_holds_the_statistics(results, capsys):
    assert main(["statistics", str(results)]) == 0
    said = capsys.readouterr().out
    assert "pairs     12, 1 of them left out" in said
    assert "RMS at most" in said
    assert sorted(p.name for p in results.iterdir()) == [
        "statistics.nc", "statistics.pdf", "statistics.png", "velocity.nc"
    ]  # fmt: skip
    with xr.open_dataset(results / "velocity.nc", engine="h5netcdf", decode_times=False) as velocity:
        expected = SeriesStatistics(velocity.isel(time=0))
        for k in range(12):
            expected.add(velocity.isel(time=[k]))
    with xr.open_dataset(results / "statistics.nc", engine="h5netcdf") as found:
        for name, values in expected.result().items():
            np.testing.assert_array_equal(found[name], values)
            assert found[name].attrs["units"] == values.attrs["units"]
        assert found.attrs["pairs_left_out"] == 1
    with h5netcdf.File(results / "statistics.nc") as file:
        assert file.dimensions["x"].size == 4
    xr.testing.assert_equal(plenopiv.statistics_of(results), expected.result())


def test_two_pairs_have_an_interval_of_the_mean_alone(results, field_of, capsys):
    rng = np.random.default_rng(0)
    fields = [field_of(rng.normal(2.0, 0.5, (3, 2, 3, 4)), 0.1, time=1e-3 * k) for k in range(2)]
    write_velocity(results / "velocity.nc", xr.concat(fields, "time"))
    assert main(["statistics", str(results), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["statistics"]["median_rms_std_m_s"] == [None] * 3
    assert main(["statistics", str(results), "--overwrite"]) == 0
    told = capsys.readouterr()
    assert re.search(r"95 %: mean \+-0\.\d+ m/s, from", told.out)
    assert "2 pairs: fluctuations and their error bars take 3 or more, and are NaN or mean nothing" in told.err
    figure = convergence_figure(plenopiv.statistics_of(results))
    assert np.isfinite([axes.get_ylim() for axes in figure.axes]).all()


def test_pairs_that_are_set_aside_are_no_samples(results, field_of, tmp_path, capsys):
    """Of five pairs two count; of phases one has all that count, and the others are named."""
    rng = np.random.default_rng(0)
    values = rng.normal(2.0, 0.5, (5, 3, 2, 3, 4))
    values[1:4] = np.nan
    write_velocity(
        results / "velocity.nc", xr.concat([field_of(v, 0.1, time=1e-3 * k) for k, v in enumerate(values)], "time")
    )
    assert main(["statistics", str(results)]) == 0
    assert "2 pairs: fluctuations and their error bars take 3 or more" in capsys.readouterr().err
    (tmp_path / "phases.csv").write_text("pair,phase\n" + "".join(f"{k},{90 * (k % 2)}\n" for k in range(5)))
    assert main(["statistics", str(results), "--phase", str(tmp_path / "phases.csv"), "--bins", "4"]) == 0
    told = capsys.readouterr()
    assert "4 of 4 phases have fewer than 3 pairs" in told.err
    assert "samples   2 at a place" in told.out


def test_bands_of_the_figure_are_95_percent_intervals(results):
    found = plenopiv.statistics_of(results)
    figure = convergence_figure(found)
    assert [axes.get_title() for axes in figure.axes] == [
        f"{what} of {name}" for what in ("mean", "RMS fluctuation") for name in "uvw"
    ]
    line, band = figure.axes[1].lines[0], figure.axes[1].collections[0]
    np.testing.assert_array_equal(line.get_xdata(), found.running_pairs)
    values, std = (found[f"running_mean{end}"].isel(place=0, component=1).values for end in ("", "_std"))
    np.testing.assert_array_equal(line.get_ydata(), values)
    at_the_end = band.get_paths()[0].vertices
    at_the_end = at_the_end[at_the_end[:, 0] == float(found.running_pairs[-1])][:, 1]
    assert at_the_end.max() == pytest.approx(values[-1] + 1.96 * std[-1])
    assert at_the_end.min() == pytest.approx(values[-1] - 1.96 * std[-1])


@pytest.mark.full
def test_the_figure_is_drawn(results, monkeypatch):
    monkeypatch.undo()
    assert main(["statistics", str(results)]) == 0
    assert (results / "statistics.png").read_bytes()[:4] == b"\x89PNG"
    assert (results / "statistics.pdf").read_bytes()[:5] == b"%PDF-"
    (results / "velocity.nc").write_bytes((results / "velocity.nc").read_bytes()[:3000])
    assert main(["statistics", str(results), "--overwrite"]) == 2  # a child process tries the file first


@pytest.mark.parametrize(("limit", "loads"), [(1, 12), (5000, 3), (1 << 20, 1)])
def test_a_long_file_is_read_in_parts(results, monkeypatch, limit, loads):
    """A field here is 1,200 bytes and its coordinates."""
    whole = plenopiv.statistics_of(results / "velocity.nc")
    monkeypatch.setattr(series_statistics, "BLOCK_BYTES", limit)
    load, seen = xr.Dataset.load, []
    monkeypatch.setattr(xr.Dataset, "load", lambda self: (seen.append(self.sizes["time"]), load(self))[1])
    found = plenopiv.statistics_of(results)
    xr.testing.assert_identical(found, whole)
    assert len(seen) == loads
    assert sum(seen) == 12
    assert max(seen) == 12 // loads


def test_phases_on_the_command_line(results, tmp_path, capsys):
    signal = tmp_path / "signal.csv"
    signal.write_text("pair,phase\n" + "\n".join(f"{k},{180 * (k % 2)}" for k in range(12)))
    command = ["--json", "statistics", str(results), "--phase", str(signal), "--bins", "2"]
    assert main(command) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["files"] == [str(results / "phase-statistics.nc")]
    assert last["statistics"]["pairs"] == 12
    with xr.open_dataset(results / "phase-statistics.nc", engine="h5netcdf") as found:
        assert found.phase.values.tolist() == [0.0, 180.0]
        assert found.pairs.values.tolist() == [6, 6]
        assert found.pairs_left_out.values.tolist() == [1, 0]
    assert main(command) == 2
    assert "--overwrite" in capsys.readouterr().out
    signal.write_text("pair,phase\n12,0\n")
    assert main([*command, "--overwrite"]) == 2
    assert "names pair 12, the series has pairs 0 to 11" in capsys.readouterr().out


@pytest.mark.parametrize("command", [["statistics"], ["correlate", "--ensemble"]])
@pytest.mark.parametrize(("option", "said"), [("--bins", "--bins 4: is of"), ("--period", "--period 4: is of")])
def test_parts_of_a_period_without_phases_are_refused(results, capsys, command, option, said):
    assert main([*command, str(results), option, "4"]) == 2
    assert said in capsys.readouterr().err.replace("\n", " ")


def test_bins_are_not_without_bound(results, capsys):
    assert main(["statistics", str(results), "--phase", "signal.csv", "--bins", "1000000"]) == 2
    assert "--bins" in (line := capsys.readouterr().err)
    assert line.count("\n") == 1


def test_one_line_for_what_cannot_be_read(results, tmp_path, capsys):
    def said(*words):
        assert main(["statistics", *map(str, words)]) == 2
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        return line

    assert "velocity.nc: no such file" in said(tmp_path)
    assert "none.nc: no such file" in said(results / "none.nc")
    assert "ends in .nc" in said(results, "--out", results / "statistics.txt")
    assert "cannot be read" in said(results, "--phase", tmp_path / "none.csv")
    (tmp_path / "velocity.nc").write_bytes(b"CDF" * 100)
    assert "is no velocity file or is damaged" in said(tmp_path)
    assert [p.name for p in results.iterdir()] == ["velocity.nc"]


def test_what_is_read_is_not_replaced(results, capsys):
    velocity, alias = results / "velocity.nc", results / "alias.nc"
    alias.symlink_to(velocity)
    before = velocity.read_bytes()
    for out in (velocity, alias):
        assert main(["statistics", str(results), "--out", str(out), "--overwrite"]) == 2
        assert "is what would be read; write to another name with --out" in capsys.readouterr().err.replace("\n", " ")
    assert velocity.read_bytes() == before


def test_a_series_without_a_vector(results, field_of):
    lost = field_of(np.full((3, 2, 3, 4), np.nan), np.nan, np.zeros((2, 3, 4)), time=0.0)
    write_velocity(results / "velocity.nc", lost)
    with pytest.raises(PlenoPIVError, match="no vector counts"):
        plenopiv.statistics_of(results)


@pytest.mark.parametrize(
    ("count", "words"), [(40, "outlasts 2 pairs"), (20, "seems, perhaps by chance, to outlast 2 pairs")]
)
def test_correlation_beyond_the_lags_is_a_warning(results, field_of, capsys, monkeypatch, count, words):
    monkeypatch.setattr(statistics, "write_statistics", lambda path, found: None)
    walk = np.cumsum(np.random.default_rng(1).normal(size=(count, 3, 2, 3, 4)), 0)
    fields = [field_of(v, 0.1, time=float(k)) for k, v in enumerate(walk)]
    write_velocity(results / "velocity.nc", xr.concat(fields, "time"))
    assert main(["statistics", str(results), "--lags", "2", "--quiet"]) == 0
    assert words in capsys.readouterr().err
