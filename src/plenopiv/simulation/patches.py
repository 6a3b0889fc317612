"""Light of many particles gathered into one image, whatever traces it.

Work is cut into *items*, a stretch of one particle's rays with an image patch of its own (``kernels``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.simulation import kernels
from plenopiv.threads import in_threads

Progress = Callable[[int, int], None]
RAYS_PER_ITEM = 1 << 17
PATCH_PIXELS_PER_BATCH = 1 << 23  # 64 MiB of patches at a time


class Items(NamedTuple):
    """Stretches of rays, arrays (items,): whose, from which ray to which, ``window`` (items, 4) as ``gathered`` takes
    it, and where in ``patches`` its pixels begin."""

    particle: NDArray[np.int64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    window: NDArray[np.int64]
    start: NDArray[np.int64]
    patches: NDArray[np.float64]


def gathered(
    shape: tuple[int, int],
    window: NDArray[np.int64],
    rays: int,
    trace: Callable[[Items], None],
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """The image of ``shape`` (rows, columns) to which ``trace`` adds, batch by batch, the light of ``rays`` of each
    particle.

    ``window`` (n, 4): first column, first row, columns and rows of the pixels that each particle's light can reach.
    ``progress(done, total)`` counts particles.
    """
    chunks = -(-rays // RAYS_PER_ITEM)
    seen = np.flatnonzero((window[:, 2] > 0) & (window[:, 3] > 0))
    particle = np.repeat(seen, chunks)
    first = np.tile(np.arange(chunks) * RAYS_PER_ITEM, seen.size)
    last = np.minimum(first + RAYS_PER_ITEM, rays)
    area = (window[:, 2] * window[:, 3])[particle]

    image = np.zeros(shape)
    begin = 0
    while begin < particle.size:
        fits = int(np.searchsorted(np.cumsum(area[begin : begin + 65536]), PATCH_PIXELS_PER_BATCH, "right"))
        now = slice(begin, begin + max(1, fits))
        start = np.concatenate([[0], np.cumsum(area[now])])
        items = Items(particle[now], first[now], last[now], window[particle[now]], start[:-1], np.zeros(start[-1]))
        trace(items)
        in_threads(kernels.add_patches, image.shape[0], image, items.window, items.start, items.patches)
        begin = min(now.stop, particle.size)
        if progress is not None:
            progress(len(window) * begin // particle.size, len(window))
    return image
