"""The benchmark's conditions are possible experiments, and their flows move as many voxels as they say."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from plenopiv.experiment import Experiment
from plenopiv.simulation.experiment_file import experiment_toml

SCRIPTS = Path(__file__).parents[2] / "benchmarks" / "accuracy"
sys.path.insert(0, str(SCRIPTS))
from conditions import CONDITIONS, DT_S  # noqa: E402

pytestmark = pytest.mark.full


def displacements(condition, n=41):
    """Voxels per frame at points of the volume, (m, 3)."""
    axes = np.meshgrid(*(np.linspace(lo, hi, n) for lo, hi in condition.volume_mm()), indexing="ij")
    velocity = condition.flow()(np.stack(axes, -1).reshape(-1, 3))
    return velocity * 1e3 * DT_S / np.array(condition.voxel_mm()) - condition.drift_voxels


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_condition_is_an_experiment(name):
    """Windows fit, f-numbers match, and at most the volume's rim is missed by a view; what fails is warned about."""
    c = CONDITIONS[name]
    text = experiment_toml(c.camera(), "upright", DT_S, c.volume_mm(), c.voxel_mm(), c.windows)
    experiment = Experiment.from_dict(tomllib.loads(text), f"{name}.toml")
    missed = [line for line in experiment.warnings() if "missed by some views" in line]
    shallow = [line for line in experiment.warnings() if "displacements in depth come out too small" in line]
    assert set(experiment.warnings()) == {*missed, *shallow}
    assert bool(shallow) == (name == "pmr8")
    assert not missed or c.x_mm is not None
    sides = [hi - lo for lo, hi in c.volume_mm()]
    assert all(s > 1.5 * w * v for s, w, v in zip(sides, c.windows[-1], c.voxel_mm(), strict=True))


def test_flows_have_their_stated_strength():
    shear, ring, abc = (displacements(CONDITIONS[name]) for name in ("base", "vortex-ring", "abc"))
    assert np.abs(shear).max(0) == pytest.approx([5.0, 0.0, 0.0], abs=1e-9)
    assert np.abs(ring).max() == pytest.approx(4.0, rel=0.02)
    assert np.sqrt((abc[:, :2] ** 2).mean(0)) == pytest.approx([3.0, 3.0], rel=0.15)  # not whole wavelengths
    assert displacements(CONDITIONS["uniform"]) == pytest.approx(np.zeros((41**3, 3)))


def test_conditions_differ_from_the_base_in_what_they_say():
    assert CONDITIONS["half"].camera().main_lens.aperture_mm == pytest.approx(18.75)
    assert CONDITIONS["pmr28"].camera().main_lens.aperture_mm == pytest.approx(50.0)
    assert CONDITIONS["pmr8"].camera().pixels_per_microlens == pytest.approx(8)
