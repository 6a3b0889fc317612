"""Light that frames of different pairs have in common, dead pixels, filtered frames, and the orientation of files."""

import shutil

import numpy as np
import pytest
import tifffile
from recordings import edited, looked_at, record, wrong

from plenopiv.checks import at_rest, filtered, stamps
from plenopiv.sensor import Sensor


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """A folder of two pairs of different particles, and the light of a third one's."""
    folder = tmp_path_factory.mktemp("two")
    for seed in (1, 2, 3):
        made = record(folder / f"made{seed}", seed=seed)
        for pulse in "ab":
            shutil.copy(made / f"{pulse}.tif", folder / f"p{seed}_{pulse}.tif")
    shutil.copy(made / "white.tif", folder)
    text = (made / "experiment.toml").read_text()
    (folder / "experiment.toml").write_text(text.replace('frames = ["a.tif", "b.tif"]', 'pairs = "p[12]_{a,b}.tif"'))
    return folder


@pytest.fixture
def folder(two, tmp_path):
    shutil.copytree(two, tmp_path / "pairs", ignore=shutil.ignore_patterns("made*"))
    return tmp_path / "pairs"


@pytest.mark.usefixtures("still")
@pytest.mark.full
@pytest.mark.parametrize(("share", "names"), [(0.0, []), (0.5, ["static-light"])])
def test_particles_stuck_to_a_window(folder, share, names):
    light = share * np.maximum(tifffile.imread(folder / "p3_a.tif") - 60.0, 0)
    for pair in "12":
        for pulse in "ab":
            edited(folder, f"p{pair}_{pulse}", lambda counts: np.clip(counts + light, 0, 4095))
    assert sorted(wrong(looked_at(folder))) == names


def test_from_which_correlation_light_is_at_rest():
    assert at_rest.finding(0.1) is None
    assert at_rest.finding(0.2).severity == "warning"


@pytest.mark.usefixtures("still")
def test_dead_rows(recording):
    for name in ("a", "b", "white"):

        def dead(counts):
            counts[100:103] = 0
            return counts

        edited(recording, name, dead)
    assert "dead-pixels" in wrong(looked_at(recording))


@pytest.mark.parametrize(("tags", "words"), [((1, 1), None), ((3, 3), "a.tif is to"), ((1, 6), "white.tif is to")])
def test_orientation_by_tags(tags, words):
    found = stamps.turned(list(zip(("a.tif", "white.tif"), tags, strict=True)))
    assert (found and found.words.startswith(words)) == (words and True)


@pytest.mark.usefixtures("still")
def test_the_tag_is_read(recording):
    edited(recording, "a", lambda counts: counts, extratags=[(274, "H", 1, 3, True)])
    assert set(wrong(looked_at(recording))) == {"orientation-tag"}


@pytest.mark.usefixtures("still")
def test_a_median_filter_in_the_camera(recording):
    from scipy.ndimage import median_filter

    for name in "ab":
        edited(recording, name, lambda counts: median_filter(counts, 3))
    assert "filtered" in wrong(looked_at(recording))


@pytest.mark.parametrize(("scale", "most"), [(1.0, 1.3), (0.25, 1.3), (2.0, 2.3)])
def test_neighbours_are_equal_as_often_as_noise_makes_them(scale, most):
    rng = np.random.default_rng(0)
    counts = np.rint(60 + scale * rng.poisson(400.0, (200, 300))).astype(np.uint16)
    assert 0.7 < filtered.equal_neighbours(counts, Sensor(300, 200, 0.0055, 12, 60)) < most


@pytest.mark.usefixtures("still")
@pytest.mark.parametrize("masked", [False, True])
def test_a_reflection_that_is_masked_is_no_light_in_common(recording, masked):
    """A spot that is in all frames; at its place nothing is measured once it is masked."""
    low, high = 100, 130
    for name in "ab":

        def lit(counts):
            counts[low:high, low:high] = 2500
            return counts

        edited(recording, name, lit)
    sides = [[low - 2, low - 2], [high + 2, low - 2], [high + 2, high + 2], [low - 2, high + 2]]
    found = wrong(looked_at(recording, **({"recording__mask": [sides]} if masked else {})))
    assert ("static-light" in found) == (not masked)
