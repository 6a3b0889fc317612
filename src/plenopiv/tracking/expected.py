"""Where the particles of a pair's first frame are to be looked for in the second.

Correlation says where they have moved to, but for what a window does not resolve; the brightest voxels of the second
volume are where its particles are, but for those that are hidden by others. So the particles of the first frame are
linked with the brightest voxels as they will be with the particles of the second (``links``): those that are linked are
looked for there, those that are not where the links of their neighbours let expect them. Bright voxels that are nowhere
near a particle that is expected hold one that has entered.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.links import NEIGHBOURS, Predictor, link, of_neighbours, predicted_displacements

PLACE_OF_A_PEAK = 0.5  # of the scatter of displacements, standard deviation
LIGHT_OF_A_PEAK = 0.5  # relative standard deviation
SAME = 2.5  # times that scatter: a peak nearer than that to an expected particle is that particle

Array = NDArray[np.float64]


def expected(
    first: FrameParticles,
    peak_mm: Array,
    peak_light: Array,
    displacement_mm: Predictor,
    scatter_mm: Array,
    most_mm: float,
) -> tuple[Array, Array]:
    """Positions (m, 3) in mm and light (m,) of particles in the second frame of a pair: those of the ``first`` frame,
    in their order, and then those that have entered. ``peak_mm`` (n, 3), ``peak_light`` (n,): of the second volume's
    brightest voxels; the others as for ``links.link``. Particles whose displacement is not known are left out."""
    covariance = np.zeros((len(peak_light), 4, 4))
    covariance[:, range(3), range(3)] = (PLACE_OF_A_PEAK * scatter_mm) ** 2
    covariance[:, 3, 3] = (LIGHT_OF_A_PEAK * peak_light) ** 2
    peaks = FrameParticles(peak_mm, peak_light, covariance, np.ones(len(peak_light)), np.nan)
    links = link(first, peaks, displacement_mm, scatter_mm, most_mm)
    position = first.position_mm + predicted_displacements(first.position_mm, displacement_mm)
    brighter = 1.0
    if len(links.a) > NEIGHBOURS:
        position += of_neighbours(first.position_mm, links.a, peak_mm[links.b] - position[links.a])
        brighter = float(np.median(first.light[links.a] / peak_light[links.b]))
    position[links.a] = peak_mm[links.b]
    known = np.isfinite(position).all(1)
    apart, _ = cKDTree(position[known] / scatter_mm).query(peak_mm / scatter_mm)
    entered = apart > SAME
    return (
        np.concatenate([position[known], peak_mm[entered]]),
        np.concatenate([first.light[known], brighter * peak_light[entered]]),
    )
