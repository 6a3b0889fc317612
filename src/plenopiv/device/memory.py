"""What the reconstruction of a frame takes of a device's memory, told by the compiled programs without running them.

The largest program is that of a group of views: it holds the volume, which is corrected in place, the frame, what is
known of the camera, and what the compiler needs in between, a few maps of one plane among it. Before, candidates, a
byte each, become that volume while the pixels' bounds are held.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from plenopiv.device.listed import SHARE
from plenopiv.device.mart import Frame, correct_views, exponents
from plenopiv.device.projection import OnDevice, on_device
from plenopiv.device.several import SeveralOnDevice
from plenopiv.projection.protocol import Projection
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import Tile

START = 5, 12  # bytes a voxel while candidates become a volume; of several cameras, each of which has a list of them


def frame_bytes(
    projection: Projection,
    settings: ReconstructionSettings,
    tiles: Sequence[Tile] = (),
    *,
    saturated: bool = True,
    background: bool = False,
) -> int:
    """Bytes of the device's memory that a frame takes at the most, in ``tiles`` or none. ``saturated``: with saturated
    pixels; ``background``: with static light that was taken off.

    Raises PlenoPIVError for weights that are not exact areas.
    """
    heights = {tile.high - tile.low: tile for tile in tiles}
    parts = [projection.tile(tile.low, tile.high) for tile in heights.values()] or [projection]
    return max(tile_bytes(on_device(part), settings, saturated, background) for part in parts)


def tile_bytes(device: OnDevice, settings: ReconstructionSettings, saturated: bool, background: bool) -> int:
    """The same of one tile, or of a whole volume."""
    form, views = device.form, device.host.views
    pixels = views, form.pixels
    frame = Frame(
        _array(pixels, jnp.float32),
        _array(pixels, jnp.bool_),
        _array(pixels, jnp.bool_) if saturated else None,
        _array(pixels if background else (), jnp.float32),
    )
    tables, volume = (
        jax.tree.map(lambda each: _array(each.shape, each.dtype), device.tables),
        _array(form.grid, jnp.float32),
    )
    listed = form.listed_shape(1.0 if settings.method == "mart" else SHARE)
    most = 0
    for _, together in exponents(settings.iterations, settings.relaxation, views):
        group = _array((together,), jnp.int32), _array((), jnp.int32), _array((), jnp.float32)
        with jax.enable_x64(form.double):
            used = correct_views.lower(form, tables, frame, volume, listed, *group).compile().memory_analysis()
        ends = used.argument_size_in_bytes + used.output_size_in_bytes - used.alias_size_in_bytes
        most = max(most, ends + used.temp_size_in_bytes)
    return int(max(most, START[isinstance(device, SeveralOnDevice)] * prod(form.grid) + 4 * prod(pixels)))


def _array(shape: tuple[int, ...], kind: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, np.dtype(kind))
