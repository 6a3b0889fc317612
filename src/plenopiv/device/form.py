"""What programs for a projection are compiled for: what MART on the device knows of cameras."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import jax
from numpy.typing import NDArray

Update = Callable[[jax.Array, jax.Array], jax.Array]


class Form(Protocol):
    """What programs for a projection are compiled for; it is hashable. ``tables``: what it works with."""

    @property
    def grid(self) -> tuple[int, int, int]:
        """Planes, rows and columns of voxels; of a tile, some rows more than it has (``of_tile``)."""

    @property
    def pixels(self) -> int:
        """Of each view, with those that are only there for the sake of shapes."""

    @property
    def double(self) -> bool:
        """Whether programs need JAX's double precision switched on."""

    def padded(self, values: NDArray, views: NDArray | None = None) -> NDArray:
        """Values (view, pixel) of the host as the device has them: of ``views``, None for all."""

    def inner(self, values: NDArray, views: NDArray | None = None) -> NDArray:
        """The inverse of ``padded``."""

    def forward(self, tables: Any, views: jax.Array, volume: jax.Array) -> jax.Array:
        """The volume's light in several views, (views, pixels)."""

    def back(
        self, tables: Any, views: jax.Array, images: jax.Array, volume: jax.Array, listed: Any, update: Update
    ) -> jax.Array:
        """``volume`` with its ``listed`` voxels replaced by ``update(voxels, total)``, where ``total`` is the sum of
        ``images`` (views, pixels) over the pixels that each of them lights, by weights. Where nothing is listed, all
        are."""

    def listed(self, volume: jax.Array, like: Any = None) -> Any:
        """The voxels of ``volume`` that are not 0, for ``back``; in as much memory as a list ``like`` it takes, if that
        suffices, so that programs are shared. Reads numbers of voxels from the device."""

    def listed_shape(self, share: float) -> Any:
        """The shapes of a list of a ``share`` of the voxels."""
