"""A series on the page: its times, mean and RMS, and numbers that are the data's."""

import numpy as np
import pytest
import xarray as xr
from pages import Parsed, example, field, numbers, without_figures, write

from plenopiv.io.netcdf import write_velocity
from plenopiv.report import series_of_file
from plenopiv.report.field import field_data
from plenopiv.report.moments import moments, series_in
from plenopiv.statistics import SeriesStatistics


def series(count=5, shape=(4, 5, 6)):
    """``count`` fields of different noise, a tenth replaced, one vector of the first not measured."""
    rng = np.random.default_rng(3)
    fields = [field(shape).assign_coords(time=[0.01 * k]) for k in range(count)]
    for one in fields:
        for name in "uvw":
            one[name] = one[name] + rng.normal(size=one[name].shape)
        one["valid"] = one["valid"].copy(data=rng.random(one["valid"].shape) > 0.1).astype(np.int8)
    fields[0]["u"][0, 1, 2, 3] = np.nan
    return xr.concat(fields, "time")


def test_mean_and_rms_are_those_of_the_statistics():
    whole = series()
    statistics = SeriesStatistics(whole.isel(time=[0]))
    for k in range(whole.sizes["time"]):
        statistics.add(whole.isel(time=[k]))
    wanted = statistics.result()
    mean, rms = moments(series_in(whole), (1, 1, 1), 3)[-2:]
    assert (mean.kind, rms.kind) == ("mean", "rms")
    for name in "uvw":
        np.testing.assert_allclose(mean.values[name], wanted[f"{name}_mean"].values, rtol=1e-6)
        np.testing.assert_allclose(rms.values[name], wanted[f"{name}_rms"].values, rtol=1e-6)


def test_times_are_evenly_chosen_and_thinned_alike():
    whole = series(9)
    found = moments(series_in(whole), (2, 1, 3), 3)
    assert [moment.kind for moment in found] == ["time", "time", "time", "mean", "rms"]
    assert [moment.label for moment in found[:3]] == [
        "pair 1 of 9, t = 0 s",
        "pair 5 of 9, t = 0.04 s",
        "pair 9 of 9, t = 0.08 s",
    ]
    np.testing.assert_array_equal(found[1].values["u"], whole["u"].values[4, ::2, :, ::3].astype(np.float32))
    assert [moment.kind for moment in moments(series_in(whole.isel(time=[0])), (1, 1, 1), 3)] == ["time"]


def test_a_file_is_read_as_the_fields_in_memory(tmp_path, monkeypatch):
    whole = series(7)
    write_velocity(tmp_path / "velocity.nc", whole)
    monkeypatch.setattr("plenopiv.report.moments.BLOCK_BYTES", 3 * whole[["u"]].isel(time=0).nbytes * 8)
    from_file, in_memory = series_of_file(tmp_path / "velocity.nc"), series_in(whole)
    assert from_file.count == in_memory.count == 7
    for one, other in zip(moments(from_file, (1, 1, 1), 9), moments(in_memory, (1, 1, 1), 9), strict=True):
        assert one.label == other.label
        for name, values in other.values.items():
            np.testing.assert_array_equal(one.values[name], values, err_msg=name)


@pytest.mark.parametrize("outlier", [1.0, 1e6])
def test_numbers_are_the_data_s_to_a_small_part_of_their_colours(outlier):
    whole = series()
    whole["w"][2, 1, 1, 1] *= outlier
    data = field_data(whole)
    for k, moment in enumerate(data["moments"][:5]):
        for name in ("u", "v", "w", "peak_ratio"):
            limits = data["quantities"][name]["limits"]
            found, wanted = numbers(moment["values"][name]), whole[name].values[k].ravel()
            np.testing.assert_array_equal(np.isnan(found), np.isnan(wanted))
            apart = np.abs(found - wanted) / np.maximum(1, np.abs(wanted) * 1e-2)
            assert np.nanmax(apart) <= 2.1e-5 * (limits["high"] - limits["low"]), name
        np.testing.assert_array_equal(numbers(moment["values"]["valid"]), whole["valid"].values[k].ravel())
    kinds = {moment["values"]["w"]["kind"] for moment in data["moments"][:5]}
    assert kinds == ({"u2"} if outlier == 1 else {"u2", "f4"})


def test_one_scale_of_colours_for_all_times_and_one_for_rms():
    whole = series()
    whole["u"][4] *= 10
    data = field_data(whole)
    assert data["quantities"]["u"]["limits"]["high"] > 5
    assert data["quantities"]["u"]["rms"]["map"] == "sequential"
    assert "rms" not in data["quantities"]["q"]


def test_all_times_together_are_bounded(monkeypatch):
    monkeypatch.setattr("plenopiv.report.field.IN_ALL", 6 * 120)
    kinds = [moment["kind"] for moment in field_data(series(9))["moments"]]
    assert kinds == ["time"] * 4 + ["mean", "rms"]


def test_a_pair_set_aside_is_not_the_first_to_be_seen():
    whole = series()
    for name in "uvw":
        whole[name][0] = np.nan
    assert field_data(whole)["first"] == 1


def test_facts_of_the_run_stand_at_the_top(tmp_path, monkeypatch):
    without_figures(monkeypatch)
    dataset = field()
    for name, low, high in (("u", -0.2, 0.3), ("v", 0.05, 0.05), ("w", -1.0, 0.0)):
        dataset[name].values[:] = low
        dataset[name].values[0, 0, 0, 0] = high
        dataset[f"{name}_std"].values[:] = 0.0123
    text = write(tmp_path / "report.html", example(), dataset, date="2026-01-02 03:04 UTC")
    head = Parsed(text[text.index("<header>") : text.index("</header>")] + "</header>").text
    assert "experiment.toml · evaluated 2026-01-02 03:04 UTC" in head
    # 0.3 m/s in 0.5 ms are 0.15 mm, of voxels of 0.0171 and 0.077 mm
    for said in ("−5.83 to 8.75", "1.46 to 1.46", "−6.49 to 0", "−0.2 to 0.3", "0.012"):
        assert said in head, said
    for said in ("0.0005 s, upright", "pair1", "16 × 16 × 8 voxels", "last window: 0.274 × 0.274 × 0.616 mm"):
        assert said in head, said


def test_validation_of_a_series_is_of_all_pairs_and_its_figures_of_the_first(tmp_path, monkeypatch):
    without_figures(monkeypatch)
    whole = series(3)
    summary = {"replaced_share": 0.625, "vectors_inside_body": 36}
    options = {"summary": summary, "series": {"time_s": [0, 0.01, 0.02]}, "fields": series_in(whole)}
    page = Parsed(write(tmp_path / "report.html", example(), whole.isel(time=[0]), **options)).text
    said = page[page.index("62.5 % of the vectors were replaced") :]
    assert "36 vectors lie more than half inside the body" in said
    for heading in ("Where vectors were replaced", "Displacements before windows were replaced", "Uncertainty"):
        assert f"{heading}, of the first pair" in said
    alone = Parsed(write(tmp_path / "report.html", example(), whole.isel(time=[0]), summary={})).text
    assert "first pair" not in alone


def test_an_ensemble_of_phases_is_of_phases(tmp_path, monkeypatch):
    without_figures(monkeypatch)
    whole = series(3)
    whole["phase"] = "time", [0.0, 120.0, 240.0], {"units": "degree"}
    write_velocity(tmp_path / "velocity.nc", whole)
    fields, first = series_of_file(tmp_path / "velocity.nc"), whole.isel(time=[0])
    labels = [moment.label for moment in moments(fields, (1, 1, 1), 3)]
    assert labels[1] == "phase 120 degree, 2 of 3"
    assert labels[3:] == ["mean of 3 phases", "RMS fluctuation of 3 phases"]
    summary = {"ensemble": {"pairs": [5, 1, 2], "phase": [0, 120, 240]}}
    page = Parsed(write(tmp_path / "report.html", example(), first, summary=summary, fields=fields)).text
    for said in ("pairs8", "phases3", "of the first of 3 phases", "Each of 3 phases", "replaced, of the first phase"):
        assert said in page, said
    assert "pair 1" not in page
