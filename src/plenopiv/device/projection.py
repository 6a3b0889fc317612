"""Projections on the device: the same cameras as a ``projection.protocol.Projection``, with dense volumes there."""

from __future__ import annotations

from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.device.form import Form
from plenopiv.device.pinhole import PinholeOnDevice
from plenopiv.device.plenoptic import PlenopticOnDevice
from plenopiv.device.several import SeveralOnDevice
from plenopiv.projection.pinhole.projector import PinholeProjector
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.projection.protocol import Projection
from plenopiv.projection.several_cameras import SeveralCameras


class OnDevice(Protocol):
    """A projection of the host's, and the same on the device: ``form`` and ``tables`` as ``mart`` takes them. Volumes
    are float32 (nz, ny, nx), 0 where no voxel is listed."""

    @property
    def host(self) -> Projection:
        """The same in this processor's memory."""

    @property
    def form(self) -> Form:
        """What programs are compiled for."""

    @property
    def tables(self) -> Any:
        """What they work with."""

    def candidates(self, most: NDArray[np.float32], particle: ArrayLike) -> jax.Array:
        """``Projection.candidates``."""

    def visible_voxels(self) -> jax.Array:
        """``Projection.visible_voxels``."""


_last: list[tuple[Projection, OnDevice]] = []


def on_device(projection: Projection) -> OnDevice:
    """A projection on the device in use; that of the last one is kept.

    Raises PlenoPIVError for weights that are not exact areas.
    """
    if not _last or _last[0][0] is not projection:
        _last.clear()  # first, as both may not fit into the device's memory
        _last.append((projection, _made(projection)))
    return _last[0][1]


def _made(projection: Projection) -> OnDevice:
    if isinstance(projection, SeveralCameras):
        return SeveralOnDevice.of(projection)
    if isinstance(projection, PinholeProjector):
        return PinholeOnDevice.of(projection)
    assert isinstance(projection, PlenopticProjector)
    return PlenopticOnDevice.of(projection)


def forward(device: OnDevice, views: ArrayLike, volume: jax.Array) -> NDArray[np.float32]:
    """``Projection.forward`` of a dense volume: its light in several views, (views, pixels)."""
    numbers = np.atleast_1d(views).astype(np.int32)
    with jax.enable_x64(device.form.double):
        light = _forward(device.form, device.tables, numbers, volume)
    return device.form.inner(np.asarray(light), numbers) * device.host.seen[numbers]


def gather(device: OnDevice, views: ArrayLike, images: NDArray[np.float32]) -> NDArray[np.float32]:
    """``Projection.gather`` for every voxel, (nz, ny, nx), of ``images`` (views, pixels)."""
    numbers = np.atleast_1d(views).astype(np.int32)
    seen = device.form.padded(np.where(device.host.seen[numbers], images, np.float32(0)), numbers)
    dark = jnp.zeros(device.form.grid, jnp.float32)
    with jax.enable_x64(device.form.double):
        every = device.form.listed(jnp.ones(device.form.grid, jnp.float32))
        found = np.asarray(_back(device.form, device.tables, numbers, seen, dark, every))
    return found[:, : device.host.grid.shape[1]]


@partial(jax.jit, static_argnums=0)
def _forward(form: Form, tables: Any, views: jax.Array, volume: jax.Array) -> jax.Array:
    return form.forward(tables, views, volume)


@partial(jax.jit, static_argnums=0, donate_argnums=4)
def _back(form: Form, tables: Any, views: jax.Array, images: jax.Array, volume: jax.Array, listed: Any) -> jax.Array:
    return form.back(tables, views, images, volume, listed, lambda _, total: total)
