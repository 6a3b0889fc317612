"""The report: stands alone, says what it was given, shows the lattice where the pixels are."""

import re
import tomllib

import numpy as np
import pytest
import xarray as xr

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.report import projections, raw_crops, write_report
from plenopiv.report.figures import histogram_figure
from plenopiv.sensor import Sensor
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

TEXT = """
[camera]
kind = "plenoptic"
main_lens = { focal_length_mm = 50.0, aperture_mm = 25.0, magnification = -1.0 }
microlens_array = { lattice = "hexagonal", pitch_mm = 0.077, focal_length_mm = 0.308 }
sensor = { columns = 700, rows = 560, pixel_pitch_mm = 0.0055, bit_depth = 12 }
[recording]
white = "white<1>.tif"
frames = ["a.tif", "b.tif"]
dt_s = 0.0005
orientation = "upright"
[volume]
x_mm = [-1.5, 1.5]
y_mm = [-1.1, 1.1]
z_mm = [-2.0, 2.0]
voxel_mm = [0.0171428571, 0.0171428571, 0.077]
[correlation]
windows = [[48, 48, 16]]
"""


def field(nan=False):
    rng = np.random.default_rng(0)
    dims, shape = ("time", "z", "y", "x"), (1, 4, 5, 6)
    values = {name: (dims, np.full(shape, np.nan) if nan else rng.normal(size=shape)) for name in ("u", "v", "w")}
    values |= {f"{name}_raw": values[name] for name in "uvw"}
    values["valid"] = (dims, np.where(np.arange(120).reshape(shape) % 10, 1, 0).astype(np.int8))
    values["peak_ratio"] = (dims, np.full(shape, np.nan) if nan else 1 + rng.gamma(3, 1, shape))
    return xr.Dataset(values, {"time": [0.0], "z": np.arange(4.0), "y": np.arange(5.0), "x": np.arange(6.0)})


@pytest.fixture
def experiment():
    return Experiment.from_dict(tomllib.loads(TEXT))


def write(path, experiment, dataset=None, **options):
    summary = {
        "warnings": ["a.tif: 2 % <saturated>"],
        "timings_s": {"correlation": 2.5},
        "lattice": {"pitch_mm": 0.077},
    }
    dataset = field() if dataset is None else dataset
    write_report(path, title="Velocity of <jet>", experiment=experiment, summary=summary, dataset=dataset, **options)
    return path.read_text(encoding="utf-8")


def test_the_report_stands_alone_and_says_what_it_was_given(tmp_path, experiment):
    camera = experiment.camera()
    image = np.random.default_rng(0).integers(0, 4000, (560, 700)).astype(np.uint16)
    volume = DenseVolume(experiment.grid(), np.random.default_rng(0).random(experiment.grid().shape, np.float32))
    page = write(
        tmp_path / "report.html",
        experiment,
        crops=raw_crops(image, camera, "white.tif"),
        views=projections(volume),
        accuracy={"RMS along z (voxel)": 0.123},
    )
    assert page.count('src="data:image/png;base64,') == 4
    assert page.count("<img") == 4
    assert not re.search(r"https?://|<script|<link|@import", page)
    for text in ("Velocity of &lt;jet&gt;", "2 % &lt;saturated&gt;", "lattice.pitch_mm", "0.123", "2.50 s", "90.0 %"):
        assert text in page
    assert "white&lt;1&gt;.tif" in page
    assert "<jet>" not in page


def test_a_field_without_a_single_vector_still_gets_its_report(tmp_path, experiment):
    assert page_has_figures(write(tmp_path / "report.html", experiment, field(nan=True)))


def test_a_field_of_one_vector_still_gets_its_report(tmp_path, experiment):
    one = field().isel(x=[0], y=[0], z=[0])
    assert page_has_figures(write(tmp_path / "report.html", experiment, one))


def test_windows_without_light_are_not_counted_as_displacements(experiment):
    dataset = field()
    dataset["peak_ratio"][0, :2] = 0.0
    for name in "uvw":
        dataset[f"{name}_raw"][0, :2] = 0.0
    left, _, right = histogram_figure(dataset, experiment.volume.voxel_mm, 0.0005).axes
    assert sum(patch.get_height() for patch in right.patches) == 60  # half of 120
    assert all(polygon.get_xy()[:, 1].max() < 20 for polygon in left.patches)  # no spike at 0


def page_has_figures(page):
    return page.count("<img") == 2


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
