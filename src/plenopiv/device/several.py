"""Several plenoptic cameras on the device: ``projection.several_cameras`` with dense volumes, turned for each of them.

A group of views has some of each camera. So that programs have one shape, each camera works on as many views as the
group has; those that are another camera's are left out of what it gives, and are dark in what it takes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.pose import Pose
from plenopiv.device.form import Update
from plenopiv.device.listed import Listed
from plenopiv.device.plenoptic import PlenopticForm, PlenopticOnDevice, PlenopticTables
from plenopiv.projection.several_cameras import SeveralCameras


class _Own(NamedTuple):
    """Views of a group as one camera sees them, its own first: which are its own (``mine``), their numbers there, 0 for
    those of others, and where in the group they are (``order``)."""

    mine: jax.Array
    numbers: jax.Array
    order: jax.Array


@dataclass(frozen=True)
class SeveralForm:
    """What programs for several cameras are compiled for: the object's ``grid``; each camera's form, its pose, and its
    number of views."""

    grid: tuple[int, int, int]
    forms: tuple[PlenopticForm, ...]
    poses: tuple[Pose, ...]
    views: tuple[int, ...]

    @property
    def pixels(self) -> int:
        """Of each view."""
        return max(form.pixels for form in self.forms)

    @property
    def double(self) -> bool:
        """Whether programs need double precision."""
        return False

    def padded(self, values: NDArray, views: NDArray | None = None) -> NDArray:
        """Values (view, lens) of the cameras' microlenses as the device has them: of ``views``, None for all."""
        out = np.zeros((len(values), self.pixels), values.dtype)
        for form, mine in self._mine(views):
            out[mine, : form.pixels] = form.padded(values[mine, : form.lenses.count])
        return out

    def inner(self, values: NDArray, views: NDArray | None = None) -> NDArray:
        """The inverse of ``padded``."""
        out = np.zeros((len(values), max(form.lenses.count for form in self.forms)), values.dtype)
        for form, mine in self._mine(views):
            out[mine, : form.lenses.count] = form.inner(values[mine, : form.pixels])
        return out

    def _mine(self, views: NDArray | None) -> Iterator[tuple[PlenopticForm, NDArray[np.bool_]]]:
        """Each camera's form, and which of ``views`` are its own."""
        first, numbers = 0, np.arange(sum(self.views)) if views is None else views
        for form, count in zip(self.forms, self.views, strict=True):
            yield form, (numbers >= first) & (numbers < first + count)
            first += count

    def forward(self, tables: tuple[PlenopticTables, ...], views: jax.Array, volume: jax.Array) -> jax.Array:
        """The volume's light in several views, (views, pixels)."""
        images = jnp.zeros((views.size, self.pixels), jnp.float32)
        for form, pose, of_camera, own in zip(self.forms, self.poses, tables, self._own(views), strict=True):
            light = jnp.where(own.mine[:, None], form.forward(of_camera, own.numbers, turned(volume, pose)), 0.0)
            images = images.at[own.order, : form.pixels].add(light, unique_indices=True)
        return images

    def back(
        self,
        tables: tuple[PlenopticTables, ...],
        views: jax.Array,
        images: jax.Array,
        volume: jax.Array,
        listed: tuple[Listed, ...],
        update: Update,
    ) -> jax.Array:
        """``volume`` with its voxels replaced by ``update(voxels, total)`` (``Form``)."""
        total = jnp.zeros_like(volume)
        cameras = zip(self.forms, self.poses, tables, self._own(views), listed, strict=True)
        for form, pose, of_camera, own, voxels in cameras:
            light = jnp.where(own.mine[:, None], images[own.order, : form.pixels], 0.0)
            dark = jnp.zeros(form.grid, jnp.float32)
            found = form.back(of_camera, own.numbers, light, dark, voxels, lambda _, sums: sums)
            total = total + turned(found, pose.inverse())
        return update(volume, total)

    def listed(self, volume: jax.Array, like: tuple[Listed, ...] | None = None) -> tuple[Listed, ...]:
        """The voxels of a volume that are not 0, as each camera has them (``Form``)."""
        several = like or [None] * len(self.forms)
        return tuple(
            form.listed(turned(volume, pose), one)
            for form, pose, one in zip(self.forms, self.poses, several, strict=True)
        )

    def listed_shape(self, share: float) -> tuple[Listed, ...]:
        """What holds a ``share`` of the voxels, for each camera (``Form``)."""
        return tuple(form.listed_shape(share) for form in self.forms)

    def _own(self, views: jax.Array) -> list[_Own]:
        """The views of each camera."""
        out, first = [], 0
        for count in self.views:
            order = jnp.argsort((views < first) | (views >= first + count), stable=True)
            numbers = views[order] - first
            mine = (numbers >= 0) & (numbers < count)
            out.append(_Own(mine, jnp.where(mine, numbers, 0), order))
            first += count
        return out


@dataclass(frozen=True)
class SeveralOnDevice:
    """Several cameras (``host``), and the same for the device in use."""

    host: SeveralCameras
    each: tuple[PlenopticOnDevice, ...]

    @classmethod
    def of(cls, host: SeveralCameras) -> SeveralOnDevice:
        """Raises PlenoPIVError where a camera's weights are of rays."""
        return cls(host, tuple(PlenopticOnDevice.of(projector, alike=False) for projector in host.projectors))

    @cached_property
    def form(self) -> SeveralForm:
        """What programs are compiled for."""
        views = tuple(projector.views for projector in self.host.projectors)
        return SeveralForm(self.host.grid.shape, tuple(one.form for one in self.each), self.host.poses, views)

    @property
    def tables(self) -> tuple[PlenopticTables, ...]:
        """What they work with."""
        return tuple(one.tables for one in self.each)

    def candidates(self, most: NDArray[np.float32], particle: ArrayLike) -> jax.Array:
        """``SeveralCameras.candidates``, (nz, ny, nx): 1 where a voxel may hold a particle, else 0."""
        parts = [own for _, own in self.host.each_camera(most)]
        counts = np.broadcast_to(particle, len(self.each))
        return self._in_all(
            [one.candidates(own, count) for one, own, count in zip(self.each, parts, counts, strict=True)]
        )

    def visible_voxels(self) -> jax.Array:
        """``SeveralCameras.visible_voxels``, (nz, ny, nx): 1 where every camera sees a voxel, else 0."""
        return self._in_all([one.visible_voxels() for one in self.each])

    def _in_all(self, volumes: list[jax.Array]) -> jax.Array:
        out = turned(volumes[0], self.host.poses[0].inverse())
        for volume, pose in zip(volumes[1:], self.host.poses[1:], strict=True):
            out = out * turned(volume, pose.inverse())
        return out


def turned(values: jax.Array, pose: Pose) -> jax.Array:
    """``Pose.planes`` of values (nz, ny, nx): along a camera's own axes."""
    axes = pose.axes[::-1]
    return jnp.flip(jnp.transpose(values, [3 - abs(a) for a in axes]), tuple(n for n, a in enumerate(axes) if a < 0))
