"""The experiment file: what it becomes, and the one line that each mistake gets."""

import copy
import math
import tomllib
from dataclasses import fields

import numpy as np
import pytest

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.experiment.tables import CorrelationTable, ReconstructionTable
from plenopiv.lattice import Lattice
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.sensor import Sensor
from plenopiv.simulation.experiment_file import experiment_toml

TEXT = """
[camera]
kind = "plenoptic"
[camera.main_lens]
focal_length_mm = 50.0
aperture_mm = 25.0
magnification = -1.0
[camera.microlens_array]
lattice = "hexagonal"
pitch_mm = 0.077
focal_length_mm = 0.308
[camera.sensor]
columns = 1800
rows = 1350
pixel_pitch_mm = 0.0055
bit_depth = 12
black_level = 60
[recording]
white = "white.tif"
frames = ["a.tif", "b.tif"]
dt_s = 0.0005
orientation = "upright"
[volume]
x_mm = [-4.2, 4.2]
y_mm = [-3.0, 3.0]
z_mm = [-4.0, 4.0]
voxel_mm = [0.0171428571, 0.0171428571, 0.077]
[correlation]
windows = [[128, 128, 32], [64, 64, 16]]
"""


def changed(key: str, value=None) -> dict:
    """The file above with one dotted key set, or left out where the value is None."""
    tables = copy.deepcopy(tomllib.loads(TEXT))
    *path, last = key.split(".")
    place = tables
    for name in path:
        place = place.setdefault(name, {})
    if value is None:
        place.pop(last)
    else:
        place[last] = value
    return tables


def error_of(tables: dict) -> str:
    with pytest.raises(PlenoPIVError) as caught:
        Experiment.from_dict(tables, "run7.toml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("run7.toml: ")
    return message


MISTAKES = [
    ("camera.main_lens.apperture_mm", 25.0, "camera.main_lens.apperture_mm: unknown key; did you mean aperture_mm?"),
    ("camera.sensor.dt_s", 1.0, "did you mean recording.dt_s?"),
    ("camera.sensor.gamma", 1.0, "[camera.sensor] takes columns, rows"),
    ("voulme.x_mm", [0, 1], "voulme: unknown key; did you mean volume?"),
    ("camera.main_lens.f_number", 2.0, "exactly one of aperture_mm and f_number"),
    ("camera.main_lens.aperture_mm", None, "exactly one of aperture_mm and f_number"),
    ("camera.main_lens.focal_length_mm", None, "main_lens.focal_length_mm: missing; add focal_length_mm to [camera."),
    ("camera.sensor", None, "camera.sensor: missing; add a [camera.sensor] table"),
    ("camera.main_lens.focal_length_mm", "50", "camera.main_lens.focal_length_mm: must be a number, not '50'"),
    ("camera.main_lens.focal_length_mm", "50,5", "not '50,5'; write it as 50.5, without quotes"),
    ("camera.sensor.rows", "1350", "must be a whole number, not '1350'; write it as 1350, without quotes"),
    ("camera.main_lens.focal_length_mm", "f/2", "must be a number, not 'f/2'"),
    ("camera.main_lens.focal_length_mm", True, "must be a number"),
    ("camera.main_lens.focal_length_mm", math.nan, "must be a finite number"),
    ("camera.main_lens.focal_length_mm", math.inf, "must be a finite number"),
    ("camera.main_lens.focal_length_mm", -50.0, "camera.main_lens.focal_length_mm = -50.0: must be greater than 0"),
    ("camera.main_lens.magnification", 1.0, "must be negative"),
    ("camera.main_lens.aperture_mm", 0.05, "no parallax"),
    ("camera.microlens_array.pitch_mm", 77.0, "is it in mm?"),
    ("camera.microlens_array.pitch_mm", 0.008, "under two pixels"),
    ("camera.microlens_array.focal_length_mm", 308.0, "image distance, 100 mm"),
    ("camera.microlens_array.lattice", "round", "must be 'square' or 'hexagonal'"),
    ("camera.sensor.rows", 1350.0, "must be a whole number"),
    ("camera.sensor.bit_depth", 32, "less than or equal to 16"),
    ("camera.sensor.black_level", 4095, "not below full scale"),
    ("camera.kind", "pinhole", 'only "plenoptic" is supported'),
    ("recording.frames", ["a.tif"], "recording.frames: 1 frame given; a velocity needs at least two"),
    ("recording.frames", 7, "list of file names"),
    ("recording.frames", ["a.tif", 3], "list of file names"),
    ("recording.dt_s", 0, "must be greater than 0"),
    ("recording.orientation", "up", "must be 'upright' or 'sensor'"),
    ("recording.orientation", None, "recording.orientation: missing"),
    ("recording.white", None, "camera.microlens_array.rotation_deg and offset_mm"),
    ("volume.x_mm", [4.0, -4.0], "the lower limit of x_mm = [4, -4] is not below the upper one"),
    ("volume.x_mm", [1.0], "volume.x_mm: has too few entries"),
    ("volume.x_mm", 4.0, "must be a list"),
    ("volume.x_mm", [-9.0, 9.0], "seen by no view"),
    ("volume.z_mm", [-4.0, 100.0], "not in front of the main lens, which is at z = 100 mm"),
    ("volume.voxel_mm", [1e-5, 1e-5, 1e-5], "are all lengths in mm?"),
    ("volume.voxel_mm", [0.0, 1.0, 1.0], "volume.voxel_mm[0] = 0.0: must be greater than 0"),
    (
        "volume.voxel_mm",
        [17, 17, 77],
        "volume.voxel_mm: a voxel of [17, 17, 77] is as large as the volume along x, y, z",
    ),
    ("volume.voxel_mm", [0.017, 0.017, 8.0], "as large as the volume along z; is it in mm?"),
    ("reconstruction.method", "magic", "must be 'drt-mart' or 'mart'"),
    ("reconstruction.iterations", 0, "greater than or equal to 1"),
    ("reconstruction.relaxation", 1.5, "less than or equal to 1"),
    ("correlation.windows", [[64, 64]], "correlation.windows[0]: has too few entries"),
    ("correlation.windows", [64, 64, 16], "correlation.windows: must be a list of windows: [[64, 64, 16]]"),
    ("correlation.windows", [[64, 64, 16], [128, 128, 32]], "coarse to fine"),
    ("correlation.windows", [[64, 64, 128]], "128 voxels along z do not fit into a volume of 104"),
    ("correlation.overlap", 1.0, "correlation.overlap: 1.0 is out of range"),
    ("correlation.inner_window", [96, 40, 10], "correlation.inner_window: [96, 40, 10] is larger than the last"),
    ("correlation.inner_window", [40, 40], "correlation.inner_window: has too few entries"),
    ("correlation.inner_overlap", 0.95, "correlation.inner_overlap: 0.95 is out of range"),
    ("simulation", {}, "simulation.flow: missing"),
    ("tracking.wavelength_nm", 0.532, "tracking.wavelength_nm = 0.532: must be greater than or equal to 100"),
    ("tracking.grid_mm", 1e-3, "tracking.grid_mm: 4e+11 vectors are too many, 2e+07 are the most; is it in mm?"),
]


@pytest.mark.parametrize(("key", "value", "expected"), MISTAKES)
def test_a_mistake_gets_one_line_that_names_it(key, value, expected):
    assert expected in error_of(changed(key, value))


def test_several_mistakes_are_counted_and_named_by_key():
    tables = changed("camera.main_lens.apperture_mm", 25.0)
    tables["recording"]["dt_s"] = -1.0
    tables["volume"]["y_mm"] = "wide"
    message = error_of(tables)
    assert "apperture_mm: unknown key" in message
    assert message.endswith("(and 2 more: recording.dt_s = -1.0, volume.y_mm)")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"[camera]\nkind = plenoptic\n", "line 2"),
        (b"[camera]\nkind = 'plenoptic'\nkind = 'plenoptic'\n", "line 3"),
        (b"\xff\xfe\x00\x01", "is not a text file in UTF-8; name a text file, or save it as UTF-8"),
        ("[recording]\ndt_s = 5e-4  # 500 µs".encode("latin-1"), "save it as UTF-8, or write line 2 without"),
        (b"[recording]\ndt_s = 0,0005\n", "): dt_s = 0,0005; decimals take a point: 0.5, not 0,5"),
        (b"[volume]\nx_mm = [1,2 3]\n", "): x_mm = [1,2 3]"),
        (b"[recording]\ndt_s = 5e-4\ndt_s = 5e-4\n", "(at line 3, column 12): dt_s = 5e-4"),
        (b"", "camera: missing; add a [camera] table"),
    ],
)
def test_a_broken_file_is_named(tmp_path, content, expected):
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(PlenoPIVError) as caught:
        Experiment.load(path)
    assert str(path) in str(caught.value)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(PlenoPIVError, match="no such file; plenopiv init"):
        Experiment.load(tmp_path / "none.toml")
    with pytest.raises(PlenoPIVError, match="is a folder"):
        Experiment.load(tmp_path)


def test_the_shared_schema_loads(tmp_path):
    """The file that comes with a simulated recording, as recordings made elsewhere have it."""
    lattice = Lattice("hexagonal", 0.077, 0.002, (0.03, 0.02))
    camera = PlenopticCamera(MainLens(50.0, 25.0, -1.0), lattice, 0.308, Sensor(1800, 1350, 0.0055, 12, 60))
    limits = ((-4.4, 4.4), (-3.2, 3.2), (-4.0, 4.0))
    windows = ((128, 128, 32), (64, 64, 16))
    text = experiment_toml(camera, "upright", 0.0005, limits, (36 / 2100, 36 / 2100, 0.077), windows)
    (tmp_path / "experiment.toml").write_text(text)
    experiment = Experiment.load(tmp_path / "experiment.toml")
    assert experiment.grid().shape == (104, 374, 514)
    assert experiment.output_directory == tmp_path / "results"
    assert experiment.reconstruction.iterations == 5
    assert experiment.correlation.windows == windows
    assert experiment.recording_table.dt_s == 0.0005
    assert experiment.camera() == camera.with_lattice(
        Lattice("hexagonal", 0.077)
    )  # where it lies, the white image tells


def test_camera_and_grid_are_those_of_the_file():
    tables = changed("camera.microlens_array.rotation_deg", 0.5)
    tables["camera"]["microlens_array"]["offset_mm"] = [0.01, -0.02]
    experiment = Experiment.from_dict(tables)
    camera, grid = experiment.camera(), experiment.grid()
    assert camera.main_lens.object_distance_mm == pytest.approx(100.0)
    assert camera.lattice.rotation_rad == pytest.approx(math.radians(0.5))
    assert camera.lattice.offset_mm == (0.01, -0.02)
    assert camera.sensor.black_level == 60.0
    assert grid.limits_mm()[2] == pytest.approx((-4.004, 4.004))


def test_f_number_is_focal_length_over_aperture():
    tables = changed("camera.main_lens.aperture_mm")
    tables["camera"]["main_lens"]["f_number"] = 2.0
    assert Experiment.from_dict(tables).camera().main_lens.aperture_mm == pytest.approx(25.0)


def test_without_a_white_image_the_lattice_must_be_stated():
    tables = changed("recording.white")
    tables["camera"]["microlens_array"] |= {"rotation_deg": 0.0, "offset_mm": [0.0, 0.0]}
    assert Experiment.from_dict(tables).recording_table.white is None


def test_good_files_raise_no_warning():
    tables = changed("volume.x_mm", [-3.0, 3.0])
    tables["volume"]["y_mm"] = [-2.0, 2.0]
    assert Experiment.from_dict(tables).warnings() == []


def test_mismatched_f_numbers_are_stated_with_the_aperture_that_matches():
    # S_i / P_m = 100/20 = f/5 against f_l / p_l = f/4; they match at P_m = S_i p_l / f_l = 25 mm
    (line,) = Experiment.from_dict(changed("camera.main_lens.aperture_mm", 20.0)).warnings()[:1]
    assert "f/5 " in line
    assert "f/4 " in line
    assert "25 mm" in line
    barely = Experiment.from_dict(changed("camera.main_lens.aperture_mm", 25.4))
    assert not any("f-number" in line for line in barely.warnings())


def test_a_volume_within_the_dead_zone_is_warned_about():
    tables = changed("volume.z_mm", [-0.3, 0.3])
    tables["volume"]["voxel_mm"] = [0.0171428571, 0.0171428571, 0.03]
    tables["correlation"]["windows"] = [[64, 64, 16]]
    assert any("depth cannot be told" in line for line in Experiment.from_dict(tables).warnings())


def test_voxels_that_are_coarse_beside_a_microlens_are_warned_about():
    tables = changed("volume.voxel_mm", [0.0171428571, 0.0385, 0.077])
    tables["correlation"]["windows"] = [[64, 48, 16]]
    tables["volume"] |= {"x_mm": [-2.4, 2.4], "y_mm": [-2.0, 2.0]}
    assert not any("voxel_mm" in line for line in Experiment.from_dict(tables).warnings())  # hardly off the axis
    tables["volume"]["x_mm"] = [-3.0, 3.0]
    (line,) = (line for line in Experiment.from_dict(tables).warnings() if "voxel_mm" in line)
    assert line.startswith("volume.voxel_mm: 0.0385 mm along x or y is coarse beside what a microlens covers (0.077")
    assert line.endswith("give 0.019 mm or less")
    tables["volume"]["voxel_mm"] = [0.0171428571, 0.01925, 0.077]
    assert not any("voxel_mm" in line for line in Experiment.from_dict(tables).warnings())


def test_windows_no_deeper_than_a_particle_s_image_are_warned_about():
    # half the dead zone is 0.308 mm: 16 voxels of 0.05 mm are 2.6 of them, 24 of 0.05 mm or 16 of 0.077 mm are enough
    tables = changed("volume.x_mm", [-3.0, 3.0])
    tables["volume"] |= {"y_mm": [-2.0, 2.0], "voxel_mm": [0.0171428571, 0.0171428571, 0.05]}
    (line,) = Experiment.from_dict(tables).warnings()
    assert "0.8 mm deep" in line
    assert "give windows 24 voxels along z" in line
    tables["correlation"]["windows"] = [[128, 128, 32], [64, 64, 24]]
    assert Experiment.from_dict(tables).warnings() == []


def test_the_share_that_some_views_miss_is_stated():
    # At z = 4: d = 96, A = 1 + 100/96 - 2 = 1/24, B = -100/96; half width W = 1800 * 0.0055 / 2 / 1.00308.
    reach = (4.95 / 1.00308 - 12.5 / 24) * 0.96
    inside, outside = changed("volume.x_mm", [-reach + 1e-6, 1.0]), changed("volume.x_mm", [-reach - 1e-3, 1.0])
    inside["volume"]["y_mm"] = outside["volume"]["y_mm"] = [-2.0, 2.0]
    assert Experiment.from_dict(inside).warnings() == []
    assert any("missed by some views" in line for line in Experiment.from_dict(outside).warnings())


@pytest.mark.parametrize(
    ("stated", "moved"), [("none", "none"), ("minimum", "minimum"), ("glow.tif", ("../glow.tif",))]
)
def test_where_static_light_comes_from_is_the_same_elsewhere(tmp_path, stated, moved):
    experiment = Experiment.from_dict(changed("recording.background", stated), tmp_path / "experiment.toml")
    tables = tomllib.loads(experiment.dump_toml(tmp_path / "results"))
    assert Experiment.from_dict(tables).recording_table.background == moved


def test_images_of_a_target_are_the_same_elsewhere(tmp_path):
    names = ("targets/one.tif", str(tmp_path / "two.tif"))
    planes = [{"image": name, "z_mm": float(k)} for k, name in enumerate(names)]
    table = {"target": "dots", "pitch_mm": 0.6, "dot_mm": 0.2, "origin_dot_mm": 0.36, "planes": planes}
    experiment = Experiment.from_dict(tomllib.loads(TEXT) | {"calibration": table}, tmp_path / "experiment.toml")
    moved = tomllib.loads(experiment.dump_toml(tmp_path / "results"))["calibration"]["planes"]
    assert [plane["image"] for plane in moved] == ["../targets/one.tif", "../two.tif"]
    assert [plane["z_mm"] for plane in moved] == [0.0, 1.0]


def test_the_resolved_file_is_the_same_experiment_elsewhere(tmp_path):
    experiment = Experiment.from_dict(tomllib.loads(TEXT), tmp_path / "run7" / "experiment.toml")
    same = Experiment.from_dict(tomllib.loads(experiment.dump_toml()))
    assert same.correlation.inner_window == experiment.correlation.settings().sub_window == (48, 48, 13)
    assert same.correlation.settings().passes == experiment.correlation.settings().passes
    assert same.model_dump(exclude={"correlation"}) == experiment.model_dump(exclude={"correlation"})
    results = tmp_path / "run7" / "results"
    moved = Experiment.from_dict(tomllib.loads(experiment.dump_toml(results)), results / "experiment.toml")
    assert moved.recording_table.frames == ("../a.tif", "../b.tif")
    assert moved.output_directory.resolve() == results.resolve()
    assert "fine_passes" in experiment.dump_toml()


@pytest.mark.parametrize("linked", ["results", "run7"])
def test_the_resolved_file_finds_images_where_a_folder_is_a_link(tmp_path, linked):
    """To another disk, one folder deeper; named through the link."""
    disk = tmp_path / "disk" / "of" / linked
    disk.mkdir(parents=True)
    run = tmp_path / "run7"
    if linked == "results":
        run.mkdir()
    (run / "results" if linked == "results" else run).symlink_to(disk)
    for name in ("white.tif", "a.tif"):
        (run / name).touch()
    results = run / "results"
    experiment = Experiment.from_dict(changed("recording.white", "white.tif"), run / "experiment.toml")
    results.mkdir(exist_ok=True)
    text = experiment.dump_toml(experiment.output_directory)
    moved = Experiment.from_dict(tomllib.loads(text), results / "experiment.toml")
    assert (moved.folder / moved.recording_table.white).samefile(run / "white.tif")
    assert (moved.folder / moved.recording_table.frames[0]).samefile(run / "a.tif")
    assert moved.output_directory.samefile(results)


@pytest.mark.parametrize(
    ("table", "settings"), [(CorrelationTable, CorrelationSettings), (ReconstructionTable, ReconstructionSettings)]
)
def test_every_setting_is_a_key_of_the_file(table, settings):
    assert list(table.model_fields) == [field.name for field in fields(settings)]
    shared = {"windows": settings().windows} if table is CorrelationTable else {}
    assert table(**shared).settings() == settings()


def test_correlation_settings_carry_the_keys():
    tables = changed("correlation.smoothing_voxels", 1.25)
    settings = Experiment.from_dict(tables).correlation.settings()
    assert settings.smoothing == (1.25, 1.25, 1.25)
    three = Experiment.from_dict(changed("correlation.smoothing_voxels", [1.25, 0.5, 0.75])).correlation.settings()
    assert three.smoothing == (1.25, 0.5, 0.75)
    assert settings.windows == ((128, 128, 32), (64, 64, 16))
    assert settings.inner_window is None


@pytest.mark.parametrize(
    ("inner", "finest"), [([40, 40, 10], ((40, 40, 10), 0.6)), ([64, 64, 16], ((64, 64, 16), 0.5))]
)
def test_an_inner_window_is_kept_in_what_is_written_back(inner, finest):
    tables = changed("correlation.inner_window", inner)
    experiment = Experiment.from_dict(tables)
    assert experiment.correlation.settings().passes[-1] == finest
    assert Experiment.from_dict(tomllib.loads(experiment.dump_toml())).correlation == experiment.correlation


def test_coverage_agrees_with_tracing_every_ray():
    from plenopiv.cameras.coverage import coverage, half_sensor_mm

    camera = Experiment.from_dict(tomllib.loads(TEXT)).camera()
    limits = ((3.9, 5.3), (2.5, 3.9), (3.0, 6.0))
    half_x, half_y = half_sensor_mm(camera)
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 121), np.linspace(0, 12.5, 26))
    u, v = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    every = none = total = 0
    for z in np.linspace(*limits[2], 9):
        for y in np.linspace(*limits[1], 9):
            for x in np.linspace(*limits[0], 9):
                s, t = (camera.spread(z) * q + camera.scale(z) * p for q, p in ((u, x), (v, y)))
                seen = (abs(s) <= half_x) & (abs(t) <= half_y)
                every, none, total = every + seen.all(), none + (not seen.any()), total + 1
    share = coverage(camera, limits, samples=9)
    assert 0 < every < total
    assert 0 < none < total
    assert share.every_view == pytest.approx(every / total, abs=0.01)
    assert share.no_view == pytest.approx(none / total, abs=0.02)
