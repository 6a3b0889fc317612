"""A camera calibrated with a target, as numbers alone."""

from plenopiv.calibration.target.calibrated import PlaneResidual, TargetCalibration
from plenopiv.calibration.target.optics_fit import LENGTHS, NAMES
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import LensRim, MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.sensor import Sensor

NAN = float("nan")


def calibrated(map_of_lenses=True, rim=True):
    """A calibration of no camera: no two of its numbers are alike."""
    moved = LatticeMap(1, 2.75, ((1e-4, 0.1 + 0.2), (-3e-5, 1 / 3))) if map_of_lenses else None
    camera = PlenopticCamera(
        MainLens(50.1, 21.9, -1.003), Lattice("hexagonal", 0.0771, 0.005, (0.021, -0.013), moved), 0.3081,
        Sensor(1200, 960, 0.0055, 12, 61.5, "high"), LensRim(10.7, 0.13, (0.3, -0.1)) if rim else None,
    )  # fmt: skip
    model = RayModel(
        50.2, 101.3, 52.9, Medium(1.336, 64.8, 9.5, 1.52, (0.3, -0.4)), 105.1, 4.2, (1e-5, -2e-5, 3e-3), (-0.05, 0.27),
        0.0097, (0.0037, 0.0098), 1.0007, ((1e-3, -2e-3), (3e-4, 1 / 7)), (0.5, 0.0, -0.1), 0.01,
    )  # fmt: skip
    values = {name: 1.5 + k for k, name in enumerate((*NAMES[:LENGTHS], "magnification"))}
    planes = tuple(
        PlaneResidual(f"target_{k}.tif", 1.4 * k, 88 - k, 70 - k, (0.31, 0.42, 3.3), (0.01, -0.02, 0.4 - k))
        for k in range(3)
    )
    planes = (*planes, PlaneResidual("hidden.tif", 4.2, 3, 0, (NAN, NAN, NAN), (NAN, NAN, NAN)))
    field = tuple(tuple((0.1 * row, 0.2 + column, 3.0) for column in range(3)) for row in range(3))
    views = tuple((m, n, 0.1 * m, -0.2 * n) for m in range(-3, 4) for n in range(-3, 4) if m * m + n * n < 10)
    return TargetCalibration(camera, model, values, {k: 0.001 * v for k, v in values.items()}, planes, field, views)
