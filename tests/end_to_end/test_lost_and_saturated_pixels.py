"""Vectors behind masked pixels, and of overexposed frames: as right as others, with error bars that say so."""

import numpy as np
import pytest

from plenopiv.accuracy.truth import true_displacements
from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

pytestmark = pytest.mark.full

CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)),
    0.308,
    Sensor(700, 560, 0.0055, 12, 60),
)
VOLUME_MM = ((-1.5, 1.5), (-1.1, 1.1), (-2.5, 2.5))
FLOW = flow("rotation", rate_rad_s=80.0, drift_m_s=(0.0, 0.1, 0.0))  # 2.9 voxels along y everywhere
BAND = (300, 370)  # columns
SEEDS = 5, 6, 7, 8  # behind the band lie some eight independent vectors of each
SEEN = 0.5  # share of the light in the windows behind it that other pixels still have (``usable_share``)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Recordings as they should be exposed, and one twelve times brighter: (times, seed) to its folder."""
    made = {}
    for times, seed in [*((1, seed) for seed in SEEDS), (12, SEEDS[0])]:
        made[times, seed] = simulate_recording(
            tmp_path_factory.mktemp("recorded") / f"{times}-{seed}",
            CAMERA,
            FLOW,
            dt_s=0.0005,
            volume_mm=VOLUME_MM,
            windows=((64, 64, 24), (48, 48, 16)),
            seeding=Seeding(electrons_per_pixel=400.0 * times),
            rays=4000,
            seed=seed,
        )
    return made


def measured(made, mask=None):
    """Errors and stated standard deviations (3, n) in voxels, and the places (n, 3) in mm, of the vectors whose windows
    every view sees."""
    stated = Experiment.load(made.directory / "experiment.toml")
    tables = stated.model_dump(by_alias=True, exclude_none=True)
    if mask is not None:
        tables["recording"]["mask"] = [mask]
    experiment = Experiment.from_dict(tables, stated.path)
    recording = experiment.recording()
    chain, _, _ = calibrated_chain(experiment, recording)
    field = chain.displacement(*(chain.reconstruct([recording.frame(k)]).volume for k in (0, 1)))
    voxel, first = (np.array(values) for values in (chain.grid.voxel_mm, chain.grid.first_mm))
    z, y, x = np.meshgrid(field.z, field.y, field.x, indexing="ij")
    at = np.stack([x, y, z], -1).reshape(-1, 3) * voxel + first
    half = 0.5 * voxel * np.array(experiment.correlation.windows[-1])
    truth = true_displacements(at, made.a.position_mm, made.b.position_mm, half).window / voxel
    reach = np.stack([*seen_by_every_view_mm(CAMERA, at[:, 2]), np.full(len(at), VOLUME_MM[2][1])], -1)
    judged = (np.abs(at) + half <= reach).all(1) & np.isfinite(truth).all(1)
    return (
        field.displacement.reshape(3, -1)[:, judged] - truth[judged].T,
        field.std.reshape(3, -1)[:, judged],
        at[judged],
    )


def rms(error):
    return np.sqrt((error**2).mean(1))


def test_vectors_behind_a_masked_band_lose_what_half_the_light_costs_and_their_bars_hold(recorded):
    """Of half the light errors are at least the square root of two larger; a quarter more is granted. Without weighing
    voxels by what is seen of them, u behind the band is wrong by 0.15 voxel RMS, and 12 errors in 100 exceed two
    standard deviations."""
    last = CAMERA.sensor.rows - 1
    band = [[BAND[0], 0], [BAND[1], 0], [BAND[1], last], [BAND[0], last]]
    x = (np.array(BAND) - 0.5 * (CAMERA.sensor.columns - 1)) * CAMERA.sensor.pixel_pitch_mm
    parts = []
    for seed in SEEDS:
        clean, _, before = measured(recorded[1, seed])
        error, std, at = measured(recorded[1, seed], band)
        np.testing.assert_array_equal(at, before)
        near = (at[:, 0] > x[0] - 0.25) & (at[:, 0] < x[1] + 0.25)
        assert near.sum() > 30
        parts.append((clean[:, near], error[:, near], std[:, near]))
    clean, error, std = (np.concatenate(part, 1) for part in zip(*parts, strict=True))
    print(f"\nRMS {rms(clean)}, behind the band {rms(error)}, bias {error.mean(1)}")
    within = [(np.abs(error) <= k * std).mean() for k in (1, 2)]
    print(f"within 1 and 2 standard deviations: {within}")
    assert (rms(error) <= 1.25 * rms(clean) / np.sqrt(SEEN)).all()
    assert (np.abs(error.mean(1)) <= 0.05).all()
    assert within[0] >= 0.6
    assert within[1] >= 0.93


def test_overexposed_frames_are_measured_as_if_they_were_not(recorded):
    clean, _, _ = measured(recorded[1, SEEDS[0]])
    with pytest.warns(UserWarning, match="saturated"):
        error, std, _ = measured(recorded[12, SEEDS[0]])
    within = [(np.abs(error) <= k * std).mean() for k in (1, 2)]
    print(f"\nRMS {rms(clean)}, overexposed {rms(error)}, within {within}")
    assert (rms(error) <= 1.25 * rms(clean)).all()
    assert within[0] >= 0.6
    assert within[1] >= 0.9
