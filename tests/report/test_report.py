"""The report: stands alone, says what it was given, shows the lattice where the pixels are."""

import io
import re

import numpy as np
import pytest
import xarray as xr
from pages import Parsed, everything, example, field, without_figures, write
from PIL import Image
from runs import made_once

from plenopiv.accuracy.profile import DepthProfile
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.report import projections, raw_crops, volume_stack
from plenopiv.report.figures import histogram_figure
from plenopiv.sensor import Sensor
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid


@pytest.fixture
def experiment():
    return example()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A report of all that there can be, with its figures beside it: its text and the folder."""

    def made(folder):
        experiment = example()
        profile = DepthProfile(np.arange(3.0), np.ones((3, 3)), np.zeros((3, 3)), np.ones(3, int))
        measures = {"RMS along z (voxel)": 0.123, "by_depth": profile}
        given = {"figures_folder": folder / "figures", "accuracy": measures, **everything(experiment)}
        return write(folder / "report.html", experiment, **given), folder

    return made_once(tmp_path_factory, "whole", made)


def test_the_report_stands_alone_and_says_what_it_was_given(whole):
    text, _ = whole
    page = Parsed(text)
    assert {image["alt"].split(", panel")[0] for image in page.all("img")} == {
        "velocity in three slices through the middle",
        "errors by depth",
        "where vectors were replaced",
        "histograms",
        "stated standard deviations",
        "maximum projections of the volume",
        "residual by iteration",
        "raw pixels with the lattice",
    }
    assert all(image["src"].startswith("data:image/png;base64,") for image in page.all("img"))
    assert not page.all("link")
    assert not re.search(r"https?://|@import|url\(", re.sub(r"data:image[^\"]*", "", text))
    for said in ("Velocity of <jet>", "2 % <saturated>", "lattice.pitch_mm", "0.123", "2.50 s", "0.40 GB", "90.0 %"):
        assert said in page.text
    assert "white<1>.tif" in page.text
    assert "<jet>" not in text


def test_every_link_of_the_contents_leads_to_a_section(tmp_path, experiment, monkeypatch):
    without_figures(monkeypatch)
    for options in ({}, everything(experiment)):
        page = Parsed(write(tmp_path / "report.html", experiment, **options))
        targets = {link["href"].removeprefix("#") for link in page.all("a")}
        assert targets == {section["id"] for section in page.all("section") if "id" in section}
        assert len(targets) == (7 if not options else 8)


def test_figures_are_files_too(whole):
    text, folder = whole
    names = {path.name for path in (folder / "figures").iterdir()}
    kinds = ("accuracy", "displacements", "lattice", "residuals", "uncertainty", "validation", "velocity", "volume")
    assert names == {f"{kind}.{ending}" for kind in kinds for ending in ("png", "pdf")}
    assert len(Parsed(text).all("figure")) == len(kinds)
    for path in (folder / "figures").iterdir():
        content = path.read_bytes()
        if path.suffix == ".png":
            assert min(Image.open(io.BytesIO(content)).size) > 300
        else:
            assert content.startswith(b"%PDF")
            assert b"CreationDate" not in content


@pytest.mark.full
def test_a_field_without_a_single_vector_still_gets_its_report(tmp_path, experiment):
    page = Parsed(write(tmp_path / "report.html", experiment, field(nan=True)))
    assert page.data("field")["criteria"] == {}
    assert len(page.all("figure")) == 5


@pytest.mark.full
def test_a_field_of_one_vector_still_gets_its_report(tmp_path, experiment):
    page = Parsed(write(tmp_path / "report.html", experiment, field().isel(x=[0], y=[0], z=[0])))
    assert page.data("field")["axes"]["x"] == field().x.values[:1].tolist()
    assert len(page.all("figure")) == 5


@pytest.mark.full
def test_a_report_of_a_large_run_stays_small(tmp_path, experiment):
    """A field of 800 thousand vectors and pictures of noise alone, which compress worst: less than 15 MB."""
    pictures = everything(experiment)
    rng = np.random.default_rng(1)
    grid = VoxelGrid.covering((0, 9.6), (0, 9.6), (0, 9.6), (0.01, 0.01, 0.2))
    volume = DenseVolume(grid, rng.random(grid.shape, np.float32))
    pictures["views"] = projections(volume)
    pictures["stacks"][0] = volume_stack(volume)
    path = tmp_path / "report.html"
    page = Parsed(write(path, experiment, field((60, 100, 140)), **pictures))
    assert 3e6 < path.stat().st_size < 15e6
    data = page.data("field")
    assert np.prod([len(data["axes"][axis]) for axis in "xyz"]) <= 60_000
    assert "one vector in" in page.text


@pytest.mark.full
def test_a_report_of_a_long_series_stays_below_40_mb(tmp_path, experiment, monkeypatch):
    """Forty fields of 60 thousand vectors, noise with outliers that 16 bits do not hold, and pictures of noise."""
    without_figures(monkeypatch)
    one = field((20, 40, 75))
    one["u"][0, 0, 0, 0] = 1e6
    whole = xr.concat([one.assign_coords(time=[0.1 * k]) for k in range(40)], "time")
    path = tmp_path / "report.html"
    page = Parsed(write(path, experiment, whole, **everything(experiment)))
    assert 15e6 < path.stat().st_size < 40e6
    assert "12 of 40 pairs, evenly chosen" in page.text


def test_windows_without_light_are_not_counted_as_displacements(experiment):
    dataset = field()
    dataset["peak_ratio"][0, :2] = 0.0
    for name in "uvw":
        dataset[f"{name}_raw"][0, :2] = 0.0
    left, _, right = histogram_figure(dataset, experiment.volume.voxel_mm, 0.0005).axes
    assert sum(patch.get_height() for patch in right.patches) == 60  # half of 120
    assert all(polygon.get_xy()[:, 1].max() < 20 for polygon in left.patches)  # no spike at 0


def test_the_lattice_falls_on_the_micro_images():
    """Micro-images drawn ray by ray: a pixel lights up where a ray through a lens centre meets the sensor."""
    camera = PlenopticCamera(
        MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077, 0.01, (0.02, 0.01)), 0.308, Sensor(400, 300, 0.0055)
    )
    image = np.zeros((300, 400), np.uint16)
    i, j = np.meshgrid(np.arange(-40, 40), np.arange(-40, 40))
    s, t = camera.lattice.centres(i, j)
    # a ray from the main lens' centre through the lens' centre goes on undeflected over f_l
    s, t = s * (1 + 0.308 / 100.0), t * (1 + 0.308 / 100.0)
    column, row = np.rint(199.5 - s / 0.0055).astype(int), np.rint(149.5 + t / 0.0055).astype(int)
    inside = (column >= 0) & (column < 400) & (row >= 0) & (row < 300)
    image[row[inside], column[inside]] = 1000
    for crop in raw_crops(image, camera, "white"):
        row, column = np.nonzero(crop.counts)
        lit = {(c + crop.corner[0], r + crop.corner[1]) for c, r in zip(column, row, strict=True)}
        drawn = {(round(c), round(r)) for c, r in crop.centres_px}
        assert len(lit) > 60
        assert drawn == lit


def test_projections_agree_for_dense_and_sparse_volumes():
    grid = VoxelGrid.covering((0, 3), (0, 2), (0, 2.1), (0.1, 0.1, 0.1))
    values = np.random.default_rng(0).random(grid.shape, np.float32)
    values[values < 0.9] = 0
    views = projections(DenseVolume(grid, values))
    np.testing.assert_array_equal(views.xy, values.max(axis=0))
    np.testing.assert_array_equal(views.xz, values.max(axis=1))
    listed = SparseVolume.from_mask(grid, values > 0)
    sparse = projections(listed.with_values(values[values > 0]))
    np.testing.assert_array_equal(sparse.xy, views.xy)
    np.testing.assert_array_equal(sparse.xz, views.xz)
