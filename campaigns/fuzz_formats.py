"""How files of a known structure are spoilt where a parser looks: fields of TIFF directories, objects of HDF5."""

from __future__ import annotations

import io
import struct
import zlib
from contextlib import suppress
from random import Random
from typing import Any

import numpy as np

TIFF_VALUES = [0, 1, 2, 3, 5, 7, 8, 12, 16, 17, 32, 64, 255, 1000, 32773, 32946, 34925, 50000, 65535, 65536, 2**24,
               2**31 - 1, 2**31, 2**32 - 1]  # fmt: skip
# width, length, bits, compression, photometric, offsets, orientation, samples, rows per strip, byte counts, planar,
# predictor, tiles, extra samples, sample format, image depth, tile depth, JPEG tables, subfile, fill order
TIFF_TAGS = [256, 257, 258, 259, 262, 273, 274, 277, 278, 279, 284, 317, 322, 323, 324, 325, 338, 339, 32997, 32998,
             347, 254, 266, 330, 306, 270, 34665, 700]  # fmt: skip
COMPRESSIONS = [1, 2, 3, 4, 5, 6, 7, 8, 32773, 32946, 33003, 34712, 34892, 34925, 34926, 34927, 34933, 34934, 50000,
                50001, 50002, 52546]  # fmt: skip
LARGEST = 1_000_000  # values of a data set that are looked at before it is changed
ATTRIBUTES = ["units", "scale_factor", "add_offset", "_FillValue", "missing_value", "calendar", "coordinates", "CLASS",
              "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_Netcdf4Dimid", "_Netcdf4Coordinates", "_Unsigned", "dtype",
              "axis", "valid_range", "flag_values", "grid_mapping", "bounds"]  # fmt: skip


def change_tiff(rng: Random, data: bytes) -> bytes:
    """Some entries of a TIFF file's first directory, or where the next one is."""
    out = bytearray(data)
    order = "<" if out[:2] == b"II" else ">"
    big = struct.unpack_from(f"{order}H", out, 2)[0] == 43
    first = struct.unpack_from(f"{order}Q" if big else f"{order}I", out, 8 if big else 4)[0]
    count = struct.unpack_from(f"{order}Q" if big else f"{order}H", out, first)[0]
    begin, size, word = (first + 8, 20, "Q") if big else (first + 2, 12, "I")
    at_count, at_value = 4, 12 if big else 8
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        entry = begin + size * rng.randrange(count)
        tag = struct.unpack_from(f"{order}H", out, entry)[0]
        what = rng.randrange(10)
        if what == 0:
            struct.pack_into(f"{order}H", out, entry, rng.choice(TIFF_TAGS))
        elif what == 1:
            struct.pack_into(f"{order}H", out, entry + 2, rng.choice((0, 1, 2, 3, 4, 5, 6, 9, 11, 12, 13, 16, 18, 99)))
        elif what == 2:
            struct.pack_into(f"{order}{word}", out, entry + at_count, rng.choice(TIFF_VALUES))
        elif what == 3:
            link = rng.choice((first, begin, 0, len(out) - 4, rng.randrange(len(out)), 2**32 - 1))
            struct.pack_into(f"{order}{word}", out, begin + size * count, link)
        elif what == 4:
            struct.pack_into(
                f"{order}{'Q' if big else 'H'}", out, first, rng.choice((0, 1, count - 1, count + 1, 65535))
            )
        elif what == 5:
            other = begin + size * rng.randrange(count)
            out[entry : entry + size] = out[other : other + size]
        elif what == 6 and tag == 259:
            struct.pack_into(f"{order}H", out, entry + at_value, rng.choice(COMPRESSIONS))
        else:
            struct.pack_into(f"{order}{word}", out, entry + at_value, _tiff_value(rng, tag))
    return bytes(out)


def _tiff_value(rng: Random, tag: int) -> int:
    return rng.choice(COMPRESSIONS) if tag == 259 and rng.random() < 0.7 else rng.choice(TIFF_VALUES)


def change_hdf5(rng: Random, data: bytes) -> bytes:
    """An HDF5 file with some objects removed, replaced, or of other types and shapes, and odd attributes."""
    import h5py

    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        for _ in range(rng.choice((1, 1, 2, 3))):
            names: list[str] = []
            file.visititems(lambda name, item, names=names: names.append(name))
            if names:
                with suppress(OSError, ValueError, TypeError, RuntimeError, KeyError, OverflowError):
                    _change_object(rng, file, rng.choice(names))
    return buffer.getvalue()


def _change_object(rng: Random, file: Any, name: str) -> None:
    import h5py

    item = file[name]
    small = isinstance(item, h5py.Dataset) and (item.size or 0) < LARGEST
    values = item[()] if small else np.zeros(3)
    attributes = dict(item.attrs)
    what = rng.randrange(16)
    if what <= 4:
        _change_attribute(rng, item)
        return
    if what == 5:
        file.move(
            name, rng.choice(("u", "v", "x", "time", "other", "a b", "ü", "velocity")) + rng.choice(("", "", "2"))
        )
        return
    if what == 6 and values.ndim and values.dtype.kind in "iuf":
        spoilt = values.astype(float)
        flat = spoilt.reshape(-1)
        flat[rng.randrange(flat.size)] = rng.choice((np.nan, np.inf, 1e300, -1e30, flat[0], 0.0))
        with np.errstate(all="ignore"):
            item[...] = spoilt.astype(values.dtype)
        return
    del file[name]
    if what == 7:
        return
    if what == 8:
        made = file.create_dataset(
            name, shape=(10**6, 10**6, 10), chunks=(100, 100, 10), dtype="f8", compression="gzip"
        )
    elif what == 9:
        made = _bomb(file, name)
    elif what == 10:
        made = file.create_dataset(name, data=rng.choice((values.T, values[None], values.reshape(-1), values[..., :0])))
    elif what == 11:
        texts = np.array(["a"] * values.size, dtype=h5py.string_dtype()).reshape(values.shape)
        made = file.create_dataset(name, data=texts)
    elif what == 12:
        kind = rng.choice(("c16", "f2", ">f8", "u8", "S4", "bool", [("a", "f4"), ("b", "i2")]))
        made = file.create_dataset(name, shape=values.shape, dtype=kind)
    elif what == 13:
        file[name] = rng.choice((h5py.SoftLink("/" + name), h5py.SoftLink("/"), h5py.ExternalLink("one.nc", "/u")))
        return
    elif what == 14:
        made = file.create_group(name)
    else:
        made = file.create_dataset(name, data=values[::-1] if values.ndim else rng.choice((0, "text", np.nan)))
    for key, value in attributes.items():
        with suppress(OSError, ValueError, TypeError, RuntimeError):
            made.attrs[key] = value


def _bomb(file: Any, name: str) -> Any:
    """A chunk of two gigabytes of zeros, packed."""
    made = file.create_dataset(name, shape=(1 << 31,), chunks=(1 << 31,), dtype="u1", compression="gzip")
    packer = zlib.compressobj(1)
    block = bytes(1 << 20)
    packed = b"".join(packer.compress(block) for _ in range(64)) + packer.flush()
    made.id.write_direct_chunk((0,), packed)
    return made


def _change_attribute(rng: Random, item: Any) -> None:
    key = rng.choice([*item.attrs, *ATTRIBUTES])
    value = rng.choice(
        ("", "furlong", "m", "s", "seconds since 2000-01-01", "days since 1e9", "days", b"\xff\xfe", 0, -1, np.nan,
         1e300, np.zeros(0), np.arange(5), np.array(["a", "b"], dtype="S1"), "x y z", "a" * 5000, np.int8(3),
         np.zeros((2, 2)), "proleptic", None)
    )  # fmt: skip
    if value is None:
        if key in item.attrs:
            del item.attrs[key]
    else:
        item.attrs[key] = value
