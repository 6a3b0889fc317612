"""From the images of several pinhole cameras to a volume: lines of sight (MLOS), then the same MART as a light field's.

MLOS-MART after Atkinson & Soria (2009): voxels that are dark in any camera are left out, the others start from the
product of what the cameras show there. MART's views are the cameras (``mart``), each of which corrects all voxels at
once, at relaxation 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.projection.pinhole.projector import PinholeProjector
from plenopiv.reconstruction.candidates import LIT_MULTIPLE
from plenopiv.reconstruction.mart import Progress, mart
from plenopiv.reconstruction.noise import Noise, noise_below
from plenopiv.reconstruction.reconstruct import SMALLEST_FLOOR, Reconstruction
from plenopiv.reconstruction.settings import TomographySettings

LIT_SHARE = 0.05  # of what the light's pixels hold on average: a lit pixel has more
SMALLEST_THRESHOLD = 1.0  # counts


def reconstruct_tomography(
    images: Sequence[NDArray],
    projector: PinholeProjector,
    settings: TomographySettings,
    *,
    name: str = "frame",
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct one frame from ``images``, one upright image (rows, columns) in counts of each camera, together.

    Raises:
        PlenoPIVError: images that are not the cameras'; the frame ``name`` shows no particles that cross.
    """
    values = projector.views_of(images)
    noise = Noise(noise_below(values[projector.seen]))
    threshold = lit_above(values, noise) if settings.threshold is None else settings.threshold
    volume = projector.lit_in_every_camera(values, threshold)
    alive = volume.column.size
    if alive == 0:
        raise PlenoPIVError(
            f"{name}: no particles: nowhere do lines of sight above {threshold:.3g} counts of all cameras cross; check "
            "the calibration, the images' order and orientation, and the threshold"
        )
    volume, residuals = mart(
        values,
        projector,
        volume,
        iterations=settings.iterations,
        relaxation=settings.relaxation,
        floor=max(noise.dark, SMALLEST_FLOOR),
        seed=settings.seed,
        overwrite=True,
        progress=progress,
    )
    return Reconstruction(volume, threshold, 0.0, noise, alive / projector.grid.size, tuple(residuals))


def lit_above(values: NDArray[np.float32], noise: Noise) -> float:
    """The count above which a line of sight is lit: three times the dark noise, a twentieth of the light's mean pixel
    (sum I^2 / sum I, which does not depend on how many particles there are while they do not overlap), and 1 at
    least."""
    light = np.maximum(values, 0.0)
    mean = float(np.sum(light**2, dtype=np.float64)) / max(float(np.sum(light, dtype=np.float64)), 1.0)
    return max(LIT_MULTIPLE * noise.dark, LIT_SHARE * mean, SMALLEST_THRESHOLD)
