"""What MART needs of the light's way between a volume and images, whatever the camera."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.volume import SparseVolume


class Projection(Protocol):
    """Between a volume and its views: portions of one main lens (``Projector``), or one camera each
    (``PinholeProjector``). Each view has as many pixels; ``forward`` and ``multiply`` share every weight."""

    @property
    def views(self) -> int:
        """Number of views."""

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(view, pixel): where there is an equation."""

    def forward(self, views: ArrayLike, volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in several views, (views, pixels), in counts; 0 where there is no equation."""

    def multiply(self, views: ArrayLike, corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply each voxel by 1 plus the share-weighted sum of ``corrections`` (views, pixels), or empty it."""
