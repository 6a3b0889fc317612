"""Masks and bodies from the experiment file to what a run leaves."""

import json
import tomllib

import imagecodecs
import numpy as np
import pytest
import tifffile
import tomli_w
import trimesh
import xarray as xr

from plenopiv.checks import check
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.preview import preview
from plenopiv.run.series import run


def changed(experiment, **tables):
    """The experiment with keys of some tables set, in its own file."""
    content = experiment.model_dump(by_alias=True, exclude_none=True)
    for table, keys in tables.items():
        content[table] |= keys
    experiment.path.write_text(tomli_w.dumps(content))
    return Experiment.load(experiment.path)


def box(experiment, low, high, name="wall.stl"):
    trimesh.creation.box(bounds=(low, high)).export(experiment.folder / name)
    return name


def reconstructed(experiment):
    recording = experiment.recording()
    chain, _, _ = calibrated_chain(experiment, recording)
    return chain, chain.reconstruct([recording.frame(0)])


@pytest.mark.full
def test_images_and_mask_turned_together_leave_the_same_volume(experiment):
    """The mask covers the upper left corner of the upright files; stored as the sensor has them, the lower right."""
    sensor = experiment.camera().sensor
    mask = np.full((sensor.rows, sensor.columns), 255, np.uint8)
    mask[:150, :160] = 0
    path = experiment.folder / "mask.png"
    path.write_bytes(imagecodecs.png_encode(mask))
    upright, before = reconstructed(changed(experiment, recording={"mask": "mask.png"}))
    for name in ("a.tif", "b.tif", "white.tif"):
        image = tifffile.imread(experiment.folder / name)
        tifffile.imwrite(experiment.folder / name, image[::-1, ::-1].copy())
    path.write_bytes(imagecodecs.png_encode(mask[::-1, ::-1].copy()))
    turned, after = reconstructed(changed(experiment, recording={"mask": "mask.png", "orientation": "sensor"}))
    np.testing.assert_array_equal(upright.layout.seen, turned.layout.seen)
    np.testing.assert_array_equal(before.volume.values, after.volume.values)
    where = upright.layout
    lens = np.flatnonzero(where.seen.any(0))
    assert not ((where.pixel[lens] < (150, 140)).all(1)).any()  # columns, rows: their micro-images are all masked
    opposite = [[sensor.columns - 1, sensor.rows - 1], [sensor.columns - 160, sensor.rows - 1]]
    opposite += [[sensor.columns - 160, sensor.rows - 150], [sensor.columns - 1, sensor.rows - 150]]
    polygon = changed(experiment, recording={"mask": [opposite], "orientation": "sensor"})
    np.testing.assert_array_equal(calibrated_chain(polygon, polygon.recording())[0].layout.seen, where.seen)


def test_a_mask_is_never_a_frame_and_moves_with_the_file(experiment, tmp_path):
    sensor = experiment.camera().sensor
    mask = np.full((sensor.rows, sensor.columns), 7, np.uint8)
    mask[0] = 0
    (experiment.folder / "white.tif").rename(experiment.folder / "w.png.tif")
    tifffile.imwrite(experiment.folder / "c-mask.tif", mask)
    found = changed(experiment, recording={"frames": "*.tif", "white": "w.png.tif", "mask": "c-mask.tif"})
    assert found.recording().names == ["a.tif", "b.tif"]
    elsewhere = Experiment.from_dict(tomllib.loads(found.dump_toml(tmp_path)), tmp_path / "e.toml")
    np.testing.assert_array_equal(elsewhere.recording().masked, found.recording().masked)


@pytest.mark.parametrize(
    "mask", [[], [[[0, 0], [1, 1]]], [[[0, 0], [1, 1], ["a", 3]]], 3, "", [[0, 0], [1, 1], [2, 2]]]
)
def test_what_is_no_mask_is_said_in_one_line(experiment, mask):
    with pytest.raises(PlenoPIVError, match=r"recording\.mask: .*polygons") as caught:
        changed(experiment, recording={"mask": mask})
    assert "\n" not in str(caught.value)


@pytest.mark.full
def test_check_does_not_measure_masked_pixels(experiment):
    """Half of the first frame is at full scale, and masked."""
    counts = tifffile.imread(experiment.folder / "a.tif")
    counts[:, :120] = experiment.camera().sensor.full_scale
    tifffile.imwrite(experiment.folder / "a.tif", counts)

    def found(experiment):
        settings = experiment.camera(), experiment.grid(), experiment.correlation.settings()
        return {finding.name: finding for finding in check(experiment.recording(), *settings).findings}

    assert found(experiment)["overexposed"].severity == "unusable"
    last = experiment.camera().sensor.rows - 1
    half = [[[0, 0], [119, 0], [119, last], [0, last]]]
    assert "overexposed" not in found(changed(experiment, recording={"mask": half}))


@pytest.mark.full
def test_a_run_says_what_the_body_left_out(experiment, capsys):
    """A wall beyond x = 0.15 mm, seen from the terminal to the report."""
    body = box(experiment, (0.15, -5, -5), (5, 5, 5))
    experiment = changed(experiment, volume={"body": body})
    assert main(["run", str(experiment.path)]) == 0
    said = capsys.readouterr().out
    folder = experiment.output_directory
    summary = json.loads((folder / "summary.json").read_text())
    with xr.open_dataset(folder / "velocity.nc", engine="h5netcdf") as file:
        field = file.load().isel(time=0)
    inside = field.inside_body.values == 1
    np.testing.assert_array_equal(inside, np.broadcast_to(field.x.values > 0.15, inside.shape))
    assert 0 < inside.sum() < inside.size
    for name in [*"uvw", *(f"{c}_{kind}" for c in "uvw" for kind in ("raw", "std"))]:
        np.testing.assert_array_equal(np.isnan(field[name].values), inside)
    assert not (field.valid.values[inside]).any()
    assert summary["vectors_inside_body"] == inside.sum()
    assert summary["replaced_share"] == pytest.approx(1 - field.valid.values[~inside].mean())
    assert f"({inside.sum()} inside the body, not measured)" in said
    assert f"{inside.sum()} vectors lie more than half inside the body" in (folder / "report.html").read_text()
    again = Experiment.load(folder / "experiment.toml")
    assert (again.folder / again.volume.body).samefile(experiment.folder / body)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_body_is_where_its_coordinates_say(experiment, axis):
    """Beyond 0 along one axis, at its positive side."""
    low = np.full(3, -5.0)
    low[axis] = 0.001
    experiment = changed(experiment, volume={"body": box(experiment, low, (5, 5, 5))})
    solid = calibrated_chain(experiment, experiment.recording())[0].solid
    along = solid.inside.any(tuple(k for k in range(3) if k != 2 - axis))
    middle = 0.5 * experiment.grid().shape[2 - axis]
    np.testing.assert_array_equal(along, solid.block[2 - axis] * (np.arange(along.size) + 0.5) > middle)


@pytest.mark.full
def test_bodies_that_cannot_be(experiment, without_report):
    def complaint(low, high):
        name = box(experiment, low, high)
        with pytest.raises(PlenoPIVError) as caught:
            run(changed(experiment, volume={"body": name}))
        assert name in str(caught.value)
        assert not experiment.output_directory.exists()
        return str(caught.value)

    assert "is it in mm, in the frame of the volume?" in complaint((30, -5, -5), (50, 5, 5))
    assert "is it in mm" in complaint((-0.001, -0.001, -0.0001), (0.001, 0.001, 0.0001))
    assert "every vector lies in it" in complaint((-5, -5, -5), (5, 5, 5))
    with pytest.raises(PlenoPIVError, match=r"none\.stl: no such file"):
        run(changed(experiment, volume={"body": "none.stl"}))


@pytest.mark.full
def test_a_preview_takes_pairs_calibration_mask_and_body_along(experiment):
    sensor = experiment.camera().sensor
    dark = np.full((sensor.rows, sensor.columns), 60, np.uint16)
    dark[::9, ::5] += 1
    dark[sensor.rows // 2 + 20, sensor.columns // 2] = 3000
    for name, counts in (("dark.tif", dark), ("first.tif", dark + 4), ("second.tif", dark + 2)):
        tifffile.imwrite(experiment.folder / name, counts.astype(np.uint16))
    row, last = sensor.rows // 2, sensor.columns - 1
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["recording"].pop("frames")
    tables["recording"] |= {
        "pairs": [["a.tif", "b.tif"], ["b.tif", "a.tif"]],
        "dark": "dark.tif",
        "background": ["first.tif", "second.tif"],
        "mask": [[[0, row], [last, row], [last, row + 5], [0, row + 5]]],
    }
    tables["volume"]["body"] = box(experiment, (0.1, -5, -5), (5, 5, 5))
    found = preview(Experiment.from_dict(tables, experiment.path))
    small = Experiment.load(found.directory / "experiment.toml").recording()
    assert small.names == ["a.tif", "b.tif"]
    assert small.masked.any(1).sum() == 6
    assert (small.unusable & ~small.masked).sum() == 1
    assert [np.median(light) for light in small.static_light.pulses] == [4, 2]
    inside = found.velocity.inside_body.values[0] == 1
    np.testing.assert_array_equal(inside, np.broadcast_to(found.velocity.x.values > 0.1, inside.shape))
