"""The maximum of a peak that may be slanted, from its values at whole voxels."""

import numpy as np


def maximum_about(correlation, middle):
    """The maximum (3,) of the quadratic through the logarithms of ``correlation(d)`` about d = ``middle`` (3,): values
    along each axis, and at the four corners in the plane of two."""
    unit = np.eye(3, dtype=int)

    def log_c(step):
        return np.log(correlation(middle + step))

    slope = np.array([(log_c(e) - log_c(-e)) / 2 for e in unit])
    bend = np.diag([log_c(e) + log_c(-e) - 2 * log_c(0) for e in unit])
    for i, e in enumerate(unit):
        for j, f in enumerate(unit):
            if i != j:
                bend[i, j] = sum(s * t * log_c(s * e + t * f) / 4 for s in (-1, 1) for t in (-1, 1))
    return middle - np.linalg.solve(bend, slope)
