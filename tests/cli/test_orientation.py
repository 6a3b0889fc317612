"""plenopiv orientation on ray-traced images of a letter and a moved target: eight ways of storing, both lattices."""

import json

import numpy as np
import pytest
import tifffile

from plenopiv.cameras.presets import preset
from plenopiv.checks.fit import TURNS
from plenopiv.checks.letter import find_letter
from plenopiv.checks.orientation import STORED, Moved, how_stored, moved_between, picture_of
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.experiment_file import experiment_toml
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.white import white_image

KINDS = ("square", "hexagonal")
F_MM = ((-0.5, 0.7, -0.25, -0.7), (-0.25, 0.7, 0.5, 0.45), (-0.25, 0.15, 0.3, -0.08))  # left, top, right, bottom
DIRECTIONS = {"right": (1, 0), "left": (-1, 0), "up": (0, 1), "down": (0, -1)}
ANSWER = {"as it is": "upright", "turned by 180 degrees": "sensor"}


def camera(kind):
    """Of the paper, 56 microlenses across."""
    return preset("pmr8", lattice=kind)


def raw(of, points_mm, seed=0, z_mm=0.0):
    """Counts of bright points in the plane z, and stray light."""
    count = len(points_mm)
    where = np.column_stack([points_mm, np.full(count, z_mm)])
    particles = Particles(where, np.full(count, 4e5 / count * 60), 0.01)
    electrons = particle_image(of, particles, rays=300, seed=seed) + 20.0
    return digitise(electrons, of.sensor, SensorNoise(), np.random.default_rng(seed))


def letter_points(seed=0, tilt_deg=0.0):
    rng = np.random.default_rng(seed)
    parts = []
    for left, top, right, bottom in F_MM:
        n = int(4000 * (right - left) * (top - bottom))
        parts.append(np.column_stack([rng.uniform(left, right, n), rng.uniform(bottom, top, n)]))
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    return np.concatenate(parts) @ np.array([[c, s], [-s, c]])


@pytest.fixture(scope="module", params=KINDS)
def scene(request):
    """A camera, its white image, the letter, and a target of random dots at rest and moved; all stored upright."""
    of = camera(request.param)
    white = digitise(white_image(of, falloff=0.3), of.sensor, SensorNoise(), np.random.default_rng(9))
    dots = np.random.default_rng(5).uniform(-1.2, 1.2, (150, 2))
    moved = {name: raw(of, dots + 0.35 * np.array(by), seed=2, z_mm=0.4) for name, by in DIRECTIONS.items()}
    both = raw(of, dots + 0.35, seed=3, z_mm=0.4)
    return of, white, raw(of, letter_points(tilt_deg=8.0)), raw(of, dots, seed=1, z_mm=0.4), moved, both


def folder_with(tmp_path, scene, turn, orientation="upright"):
    of, white = scene[:2]
    limits = ((-0.3, 0.3), (-0.3, 0.3), (-0.5, 0.5))
    text = experiment_toml(of, orientation, 0.0005, limits, (0.02, 0.02, 0.05), ((16, 16, 8),))
    (tmp_path / "experiment.toml").write_text(text)
    tifffile.imwrite(tmp_path / "white.tif", np.ascontiguousarray(TURNS[turn](white)))
    return tmp_path / "experiment.toml"


def stored(tmp_path, turn, **images):
    for name, image in images.items():
        tifffile.imwrite(tmp_path / f"{name}.tif", np.ascontiguousarray(TURNS[turn](image)))
    return [str(tmp_path / f"{name}.tif") for name in images]


def asked(capsys, *words):
    capsys.readouterr()
    code = main(["--json", "orientation", *map(str, words)])
    return code, json.loads(capsys.readouterr().out.splitlines()[-1])


@pytest.mark.parametrize("turn", TURNS)
def test_a_letter_tells_all_eight(tmp_path, scene, turn, capsys):
    file, images = folder_with(tmp_path, scene, turn), stored(tmp_path, turn, letter=scene[2])
    code, said = asked(capsys, file, *images)
    assert said["stored"] == [turn]
    assert said["orientation"] == ANSWER.get(turn)
    assert code == (0 if turn in ANSWER else 2)
    if turn not in ANSWER:
        assert "no recording.orientation describes that" in said["text"]


@pytest.mark.parametrize("turn", TURNS)
def test_two_motions_tell_all_eight(tmp_path, scene, turn, capsys):
    file = folder_with(tmp_path, scene, turn)
    images = stored(tmp_path, turn, t0=scene[3], t1=scene[4]["right"], t2=scene[5])
    code, said = asked(capsys, file, *images, "--moved", "right", "--moved", "up")
    assert said["stored"] == [turn]
    assert (said["orientation"], code) == (ANSWER.get(turn), 0 if turn in ANSWER else 2)
    assert said["certain"]


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("turn", ANSWER)
def test_one_motion_tells_the_sign_and_what_it_cannot(tmp_path, scene, turn, direction, capsys):
    file = folder_with(tmp_path, scene, turn)
    images = stored(tmp_path, turn, t0=scene[3], t1=scene[4][direction])
    code, said = asked(capsys, file, *images, "--moved", direction)
    assert (code, said["orientation"], said["certain"]) == (0, ANSWER[turn], False)
    assert said["agrees"] == (turn == "as it is")
    assert "move the target across it too, or photograph an F" in said["text"]
    assert ('put "sensor" there' in said["text"]) is (turn != "as it is")


def test_how_far_it_moved(scene):
    of = scene[0]
    pictures = [picture_of(image, of.image_pitch_px, of.sensor.black_level) for image in (scene[3], scene[4]["up"])]
    found = moved_between(pictures[0][0], pictures[1][0], pictures[0][1])
    expected = 0.35 * float(of.scale(0.4)) / of.sensor.pixel_pitch_mm
    assert abs(found.rows_px) == pytest.approx(abs(expected), rel=0.1)
    assert found.rows_px < 0
    assert abs(found.columns_px) < 3.0


def test_the_names_of_ways_are_those_of_the_turns():
    for matrix, name in STORED.items():
        for column, unit in zip(np.array(matrix).T, ((1, 0), (0, 1)), strict=True):
            image = np.zeros((9, 9))
            image[4 + unit[1], 4 + unit[0]] = 1
            row, at = np.argwhere(TURNS[name](image))[0]
            assert (at - 4, row - 4) == tuple(column)


def refused(tmp_path, capsys, *words):
    capsys.readouterr()
    assert main(["orientation", *map(str, words)]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    return line


def test_what_cannot_be_told_is_refused_in_one_line(tmp_path, scene, capsys):
    of, turn = scene[0], "as it is"
    file = folder_with(tmp_path, scene, turn)
    y, x = (g.ravel() for g in np.meshgrid(np.arange(-1.2, 1.25, 0.2), np.arange(-1.2, 1.25, 0.2)))
    grid = np.column_stack([x, y])
    other = np.random.default_rng(77).uniform(-1.2, 1.2, (150, 2))
    dots = np.random.default_rng(5).uniform(-1.2, 1.2, (150, 2))
    names = stored(
        tmp_path, turn, t0=scene[3], again=raw(of, dots, 4, 0.4), other=raw(of, other, 6, 0.4), t1=scene[4]["right"],
        g0=raw(of, grid), g1=raw(of, grid + np.array([0.1, 0.0])), slanted=scene[5],
    )  # fmt: skip
    at = dict(zip(("t0", "again", "other", "t1", "g0", "g1", "slanted"), names, strict=True))
    cases = {
        (at["t0"],): "no letter F is clear in it",
        (at["t0"], at["again"], "--moved", "right"): "did not move by a microlens",
        (at["t0"], at["other"], "--moved", "right"): "show nothing in common",
        (at["g0"], at["g1"], "--moved", "right"): "the pattern repeats itself",
        (at["t0"], at["slanted"], "--moved", "right"): "which is no axis of them",
        (at["t0"], at["t1"], at["t0"], "--moved", "right", "--moved", "up"): "an image is named twice",
        (at["t0"], at["t1"]): "2 images and 0 times --moved do not go together",
        (at["t0"], at["t1"], at["again"], "--moved", "right", "--moved", "right"): "the motions contradict each other",
        (tmp_path / "none.tif",): "none.tif: no such file",
    }
    for words, said in cases.items():
        assert said in refused(tmp_path, capsys, file, *words), words


@pytest.mark.parametrize("dark", [True, False])
def test_letters_dark_or_bright_small_askew_and_noisy(dark):
    """Drawn, without optics: from 32 pixels high on, tilted by 15 degrees to either side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rng = np.random.default_rng(1)
    for k, (family, size, tilt) in enumerate(
        (f, s, t) for f in ("DejaVu Sans", "DejaVu Sans Mono", "cmss10") for s in (80, 150) for t in (-15, 0, 15)
    ):
        canvas = FigureCanvasAgg(Figure((4, 3), dpi=160))
        canvas.figure.text(0.45, 0.55, "F", family=family, size=size, rotation=tilt, ha="center", va="center")
        canvas.draw()
        page = np.asarray(canvas.buffer_rgba())[..., 0].astype(float).reshape(120, 4, 160, 4).mean((1, 3))
        page = (page if dark else 255 - page) + rng.normal(0, 10, page.shape)
        turn = list(TURNS)[k % 8]
        assert find_letter(TURNS[turn](page)).turn == turn, (family, size, tilt)


def test_another_thing_is_no_letter():
    y, x = np.mgrid[:80, :80]
    for shape in (np.hypot(x - 40, y - 40) < 20, (abs(x - 40) < 15) & (abs(y - 40) < 25), (x + y) % 20 < 8):
        with pytest.raises(PlenoPIVError, match="no letter F is clear in it"):
            find_letter(shape.astype(float))
    with pytest.raises(PlenoPIVError, match="no letter F is clear"):
        find_letter(np.ones((40, 40)))


def test_motions_along_both_axes_are_needed_for_one_answer():
    right = ("right", Moved(20.0, 1.0, 0.9))
    assert how_stored([right]) == ["as it is", "mirrored top to bottom"]
    assert how_stored([right, ("down", Moved(0.0, 20.0, 0.9))]) == ["as it is"]
