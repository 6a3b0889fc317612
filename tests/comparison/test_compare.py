"""Two results side by side: against differences computed in one piece, and interpolation against a linear flow."""

import json
import tracemalloc

import numpy as np
import pytest
from fields import DT_S, SETTINGS, VOXEL_MM, axis, linear, regular, results

import plenopiv
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.io import netcdf
from plenopiv.recording.recording import NUMBERED
from plenopiv.report.comparison import slices_figure, write_comparison

TIMES = (0.00025, 0.00075, 0.00125)


@pytest.fixture(autouse=True)
def without_child(request, monkeypatch):
    """A child process tries each file, some tenths of a second; tests of what is wrong have it."""
    if "one_line" not in request.node.name:
        monkeypatch.setattr(netcdf, "damage", lambda path, netcdf: "")


def noisy(dataset, seed, scale=(0.05, 0.1, 0.4)):
    rng = np.random.default_rng(seed)
    changed = dataset.copy(deep=True)
    for name, size in zip("uvw", scale, strict=True):
        changed[name] = changed[name] + size * rng.standard_normal(changed[name].shape)
    return changed


def test_all_measures_against_the_differences_in_one_piece(tmp_path):
    a, b = noisy(regular(TIMES), 1), noisy(regular(TIMES), 2)
    rng = np.random.default_rng(3)
    for field in (a, b):
        field["valid"] = field["valid"].where(rng.random(field["valid"].shape) > 0.1, 0).astype(np.int8)
    b["v_std"] = 2 * b["v_std"]
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", b))
    both = ((a.valid == 1) & (b.valid == 1)).values
    assert (found.vectors, found.within, found.both) == (both.size, both.size, both.sum())
    assert found.replaced == (int((a.valid == 0).sum()), int((b.valid == 0).sum()))
    assert found.times == (3, 0, 0)
    assert not found.interpolated
    assert found.settings == ()
    depths = {None: slice(None), (-1.0, -0.6): slice(0, 2), (-0.2, 0.2): slice(2, 4), (0.6, 1.0): slice(4, 6)}
    assert len(found.rows) == 3 * len(depths)
    for row in found.rows:
        near = None if row.depth_mm is None else tuple(round(z, 9) for z in row.depth_mm)
        chosen = both[:, depths[near]]
        d = (b[row.component] - a[row.component]).values[:, depths[near]][chosen]
        std = np.hypot(a[f"{row.component}_std"], b[f"{row.component}_std"]).values[:, depths[near]][chosen]
        m = row.m_s
        assert m.count == d.size
        assert (m.mean, m.rms, m.largest) == pytest.approx((d.mean(), np.sqrt((d**2).mean()), np.abs(d).max()))
        assert m.median == pytest.approx(np.median(np.abs(d)), rel=1e-3)
        assert m.beyond == pytest.approx([np.mean(np.abs(d / std) > n) for n in (1, 2)])
        voxel = VOXEL_MM["uvw".index(row.component)]
        assert row.voxels.rms == pytest.approx(m.rms * DT_S * 1e3 / voxel)
        assert row.voxels.beyond == m.beyond
    assert found.row("u").m_s.rms == found.rows[0].m_s.rms
    for name, counts in zip("uvw", found.histograms, strict=True):
        z = ((b[name] - a[name]) / np.hypot(a[f"{name}_std"], b[f"{name}_std"])).values[both]
        np.testing.assert_array_equal(counts[1:-1], np.histogram(z, found.edges)[0][1:-1])
        assert counts.sum() == z.size


@pytest.mark.parametrize("name", ["u", "v", "w"])
def test_the_sign_is_b_minus_a(tmp_path, name):
    faster = regular()
    faster[name] = faster[name] + 0.25
    found = plenopiv.compare(results(tmp_path / "a", regular()), results(tmp_path / "b", faster))
    means = [found.row(component).m_s.mean for component in "uvw"]
    assert means == pytest.approx([0.25 * (component == name) for component in "uvw"], abs=1e-12)


def test_a_linear_flow_is_read_exactly_between_other_vectors(tmp_path):
    other = linear(axis(-0.9, 0.33, 9), axis(-0.3, 0.11, 12), axis(0.1, 0.3, 4), (0.00025,))
    found = plenopiv.compare(results(tmp_path / "a", regular()), results(tmp_path / "b", other))
    assert found.interpolated
    assert found.vectors == 6 * 5 * 7
    assert found.within == found.both == 5 * 4 * 4  # z -0.6 to 1, y -0.25 to 0.5, x 0.25 to 1
    assert max(row.m_s.largest for row in found.rows) < 1e-12
    assert found.row("u").m_s.beyond == (0, 0)


@pytest.mark.parametrize("along", ["x", "y", "z"])
def test_only_vectors_between_which_b_is_read_make_a_difference(tmp_path, along):
    """B at every second vector of A along one axis: one that was not measured takes itself and both neighbours."""
    a = regular(shape=(7, 7, 7))
    b = a.isel({along: slice(0, None, 2)}).copy(deep=True)
    hole = {"time": 0, "z": 1, "y": 1, "x": 1}
    b["valid"][hole] = 0
    for name in "uvw":
        b[name][hole] = np.nan
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", b))
    assert found.within == 7**3
    assert found.both == 7**3 - 3
    assert found.row("w").m_s.largest < 1e-12


def test_the_same_places_need_no_neighbour(tmp_path):
    """NaN beside a vector that lies at the same place."""
    b = regular()
    for name in "uvw":
        b[name][0, 2, 2, 2] = np.nan
    b["valid"][0, 2, 2, 2] = 0
    a = regular()
    a = a.assign_coords(x=a.x + 1e-9, z=a.z - 1e-9)
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", b))
    assert (found.interpolated, found.both) == (False, 6 * 5 * 7 - 1)


def test_pairs_are_matched_by_time(tmp_path):
    a, b = regular(TIMES), regular((0.00075, 0.00225, 0.00125 + 1e-9))
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", b))
    assert found.times == (2, 1, 1)
    assert found.row("w").m_s.largest < 1e-4  # w rises by 5 m/s from one time to the next
    assert found.shown.time_s == pytest.approx(0.00075)
    assert found.shown.when == "time 0.00075 s"


def test_phases_are_matched_by_phase_and_equal_times_each_once(tmp_path):
    """Mean times of phases fall and coincide; w says by 2 m/s which phase it is."""
    a = regular((0.002, 0.0031, 0.0052)).assign_coords(time=[0.0052, 0.0031, 0.0031])
    b = a.copy(deep=True).isel(time=[2, 0, 1])
    b = b.assign_coords(time=[0.0031, 0.0031, 0.0044])
    for dataset, order in ((a, [0, 1, 2]), (b, [2, 0, 1])):
        dataset["phase"] = "time", 120.0 * np.array(order), {"units": "degree"}
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", b))
    assert found.times == (3, 0, 0)
    assert found.shown.when == "phase 0 degree"
    assert found.row("w").m_s.largest == 0
    one, other = (results(tmp_path / name, a.drop_vars("phase")) for name in ("c", "d"))
    assert plenopiv.compare(one, other).times == (3, 0, 0)


def test_a_time_set_aside_counts_as_nothing_measured(tmp_path):
    a, b = regular(TIMES), regular(TIMES)
    for name in "uvw":
        b[name][0] = np.nan
    b["valid"][0] = 0
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", b))
    assert found.both == 2 * 6 * 5 * 7
    assert found.replaced == (0, 0)
    assert found.shown.time_s == TIMES[1]


def test_times_that_only_number_pairs_are_no_seconds(tmp_path):
    a = regular(TIMES)
    a["time"].attrs["long_name"] = f"{NUMBERED}; the time between pairs is not known"
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", a))
    assert found.shown.when == "pair 1"
    a = a.isel(time=[0]).assign(pairs=("time", [3]))
    a["time"].attrs["long_name"] = f"mean over the pairs of: {NUMBERED}; the time between pairs is not known"
    found = plenopiv.compare(results(tmp_path / "c", a), results(tmp_path / "d", a))
    assert found.shown.when == "the mean over all pairs"


@pytest.mark.parametrize("frame", ["camera", "laboratory"])
def test_the_page_says_whose_axes_they_are(tmp_path, frame):
    a, b = regular(), regular()
    a.attrs["frame"] = frame
    b.attrs.pop("frame", None)
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", b))
    write_comparison(tmp_path / "page.html", found)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert ("x, y, z of the laboratory" in page) == (frame == "laboratory")
    assert ("z = 0 the focal plane" in page) == (frame == "camera")


def test_settings_that_differ(tmp_path):
    changed = SETTINGS.replace("[48, 48, 16]", "[32, 32, 16]").replace('white = "../white.tif"\n', 'dark = "none"\n')
    changed = changed.replace('directory = "."', 'directory = "elsewhere"\nvolumes = true')
    found = plenopiv.compare(results(tmp_path / "a", regular()), results(tmp_path / "b", regular(), changed))
    assert [(s.key, s.a, s.b) for s in found.settings] == [
        ("recording.white", str(tmp_path / "white.tif"), None),
        ("correlation.windows", [[64, 64, 24], [48, 48, 16]], [[64, 64, 24], [32, 32, 16]]),
        ("recording.dark", None, "none"),
    ]


def test_the_same_names_in_other_folders_are_other_files(tmp_path):
    one, other = results(tmp_path / "1" / "results", regular()), results(tmp_path / "2" / "results", regular())
    found = plenopiv.compare(one, other)
    assert [s.key for s in found.settings] == ["recording.white", "recording.frames"]
    assert found.settings[0].b == str(tmp_path / "2" / "white.tif")


def test_images_of_a_target_are_the_same_from_whatever_folder(tmp_path):
    settings = SETTINGS + '\n[calibration]\nplanes = [{{ image = "{}target.tif", z_mm = 1.5 }}]\n'
    a = results(tmp_path / "a", regular(), settings.format("../"))
    same = results(tmp_path / "b", regular(), settings.format(f"{tmp_path}/"))
    assert plenopiv.compare(a, same).settings == ()
    other = results(tmp_path / "c" / "results", regular(), settings.format("../"))
    (planes,) = (s for s in plenopiv.compare(a, other).settings if s.key.startswith("calibration"))
    assert planes.a == [{"image": str(tmp_path / "target.tif"), "z_mm": 1.5}]
    assert planes.b == [{"image": str(tmp_path / "c" / "target.tif"), "z_mm": 1.5}]


def test_without_experiment_file_there_are_no_voxels(tmp_path):
    a, b = (results(tmp_path / name, regular(), None) for name in "ab")
    found = plenopiv.compare(a / "velocity.nc", b)
    assert found.settings is None
    assert {row.voxels for row in found.rows} == {None}


def test_without_standard_deviations(tmp_path):
    a = regular().drop_vars(["u_std", "v_std", "w_std"])
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", noisy(regular(), 1)))
    assert np.isnan(found.row("u").m_s.beyond).all()
    assert not found.histograms.any()


@pytest.mark.full
def test_memory_does_not_grow_with_the_number_of_times(tmp_path):
    def peak(count):
        times = 0.00025 + 0.0005 * np.arange(count)
        a, b = (results(tmp_path / f"{name}{count}", regular(times, (12, 24, 30))) for name in "ab")
        tracemalloc.start()
        plenopiv.compare(a, b)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(1)  # imports
    few, many = peak(3), peak(12)
    assert many < few + 1e6  # bytes; nine more times of one result are 4.4 MB


def test_what_cannot_be_compared_is_one_line(tmp_path):
    a = results(tmp_path / "a", regular())
    nothing = regular()
    nothing["valid"][:] = 0
    cases = {
        "later": (regular((7.0,)), "no time is in both: 0.00025 to 0.00025 s and 7 to 7 s"),
        "beside": (
            linear(axis(5.0, 0.4, 3), axis(-0.5, 0.25, 5), axis(0.0, 0.25, 7)),
            "no vector of the first lies within the second: z -1 to 1 mm and 5 to 5.8 mm",
        ),
        "nothing": (nothing, "no vector was measured in both"),
    }
    for name, (field, said) in cases.items():
        with pytest.raises(PlenoPIVError, match=said) as raised:
            plenopiv.compare(a, results(tmp_path / name, field))
        assert str(tmp_path / name / "velocity.nc") in str(raised.value)
    (tmp_path / "empty").mkdir()
    broken = results(tmp_path / "broken", regular(), "[recording\n")
    for path, said in (
        (tmp_path / "empty", "empty: holds no velocity.nc; plenopiv run writes it"),
        (tmp_path / "none", "none: no such file"),
        (broken, "experiment.toml: is not valid TOML"),
    ):
        with pytest.raises(PlenoPIVError, match=said):
            plenopiv.compare(path, a)
    whole = (a / "velocity.nc").read_bytes()
    (a / "velocity.nc").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(PlenoPIVError, match=r"velocity\.nc: is no velocity file or is damaged"):
        plenopiv.compare(a, tmp_path / "later")


@pytest.mark.full
def test_the_command_prints_the_table_and_writes_the_page(tmp_path, capsys):
    a = results(tmp_path / "run7" / "results", noisy(regular(TIMES), 1))
    hostile = SETTINGS.replace("../white.tif", "../<script>alert(1)</script>.tif")
    hostile = hostile.replace("[64, 64, 24], [48, 48, 16]", "[32, 32, 16]")
    b = results(tmp_path / "run7" / "wide", noisy(regular(TIMES), 2), hostile)
    assert main(["compare", str(a), str(b)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    page = tmp_path / "run7" / "compare.html"
    assert out.endswith(f"{page}\n")
    rms = plenopiv.compare(a, b).row("w").m_s.rms
    line = next(text for text in out.splitlines() if text.split()[:1] == ["w"])
    assert f"{rms:.3g}" in line.split()
    assert "correlation.windows: [[64, 64, 24], [48, 48, 16]] | [[32, 32, 16]]" in out
    html = page.read_text()
    assert "<script>alert" not in html
    assert html.count("<img ") == 3  # two slices, the histograms
    assert f"{rms:.3g}</td>" in html
    assert main(["compare", str(a), str(b)]) == 2
    assert "compare.html: is there already; use --overwrite" in capsys.readouterr().err
    assert page.read_text() == html
    assert main(["compare", str(a), str(b), "--out", str(tmp_path / "no" / "page.html")]) == 2
    assert "its folder is not there" in capsys.readouterr().err.replace("\n", " ")


def test_a_page_does_not_replace_a_result(tmp_path, capsys):
    a, b = (results(tmp_path / name, regular()) / "velocity.nc" for name in "ab")
    alias = tmp_path / "page.html"
    alias.symlink_to(b)
    before = b.read_bytes()
    for out, said in ((b, "use a name that ends in .html"), (alias, "is what would be read")):
        assert main(["compare", str(a), str(b), "--out", str(out), "--overwrite"]) == 2
        assert said in capsys.readouterr().err.replace("\n", " ")
    assert b.read_bytes() == before


@pytest.mark.full
def test_the_command_for_programs(tmp_path, capsys):
    a, b = (results(tmp_path / name, regular().drop_vars("u_std")) for name in "ab")
    page = tmp_path / "page.html"
    page.touch()
    assert main(["--json", "compare", str(a), str(b), "--out", str(page), "--overwrite"]) == 0
    assert page.stat().st_size > 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["vectors"] == {"a": 210, "within_b": 210, "measured_in_both": 210}
    assert told["differences"][0]["m_s"]["rms"] == 0
    assert told["differences"][0]["m_s"]["beyond"] == [None, None]
    assert told["settings"] == []


@pytest.mark.full
@pytest.mark.parametrize("flat", ["x", "y", "z"])
def test_one_vector_along_an_axis(tmp_path, flat):
    found = plenopiv.compare(*(results(tmp_path / name, regular().isel({flat: [2]})) for name in "ab"))
    assert found.both == found.vectors == 210 // regular().sizes[flat]
    write_comparison(tmp_path / "page.html", found)
    assert (tmp_path / "page.html").read_text().count("<img ") == 1 + {"x": 0, "y": 1, "z": 1}[flat]


@pytest.mark.parametrize(("across", "right", "up", "normal"), [("xy", "x", "y", "z"), ("xz", "x", "z", "y")])
def test_slices_show_each_component_where_it_is(tmp_path, across, right, up, normal):
    a, b = regular(), regular()
    b["v"][0, 3, 2, 3], b["valid"][0, 3, 2, 3] = 5.0, 0  # replaced, in the middle of all axes
    found = plenopiv.compare(results(tmp_path / "a", a), results(tmp_path / "b", b))
    panels = [axes for axes in slices_figure(found.shown, across).axes if axes.images]
    for row, name in enumerate("uvw"):
        shown = [axes.images[0].get_array() for axes in panels[3 * row : 3 * row + 3]]
        for picture, field in zip(shown, (a, b), strict=False):
            plane = field[name].isel({"time": 0, normal: a.sizes[normal] // 2}).transpose(up, right)
            np.testing.assert_allclose(picture, plane)
        assert shown[2].mask.sum() == 1  # the replaced one is left out of the difference
        assert panels[3 * row].get_xlim() == pytest.approx((-0.125, 1.625))


def test_pairs_of_a_double_frame_camera_are_those_of_one_number(tmp_path):
    """Their times are numbers times dt_s, which may have been corrected; those of a sequence are times."""
    long_name = "number of the pair and a half, times dt_s; the time between pairs is not known"
    for known, expected in ((long_name, (4, 0, 0)), ("mid-time of the two frames", (1, 3, 3))):
        one, other = regular(DT_S * (np.arange(4) + 0.5)), regular(3 * DT_S * (np.arange(4) + 0.5))
        other.attrs["dt_s"] = 3 * DT_S
        for k in range(4):
            one["u"][k], other["u"][k] = 1.0 + k, 1.5 + k
        for field in (one, other):
            field["time"].attrs["long_name"] = known
        found = plenopiv.compare(
            results(tmp_path / f"a{expected[0]}", one), results(tmp_path / f"b{expected[0]}", other)
        )
        assert found.times == expected
        if known == long_name:
            assert (found.rows[0].m_s.mean, found.rows[0].m_s.rms) == pytest.approx((0.5, 0.5))
