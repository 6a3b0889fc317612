"""Times that files bear: where they are found, and what they say of order and dt."""

import struct
import zlib
from decimal import Decimal

import h5py
import imagecodecs
import numpy as np
import pytest
import tifffile

from plenopiv.checks.stamps import Stamp, in_order, stamp
from plenopiv.recording import formats
from plenopiv.recording.sources import only_source, sources_of

COUNTS = np.arange(400, dtype=np.uint16).reshape(20, 20)
NOON = Decimal(1772445600)  # 2026-03-02 10:00:00 UTC


@pytest.fixture(autouse=True)
def without_child(monkeypatch):
    """A child process tries each HDF5 file, some tenths of a second; damaged ones are tests/hdf5's."""
    monkeypatch.setattr(formats, "damage", lambda path: "")


def tiff(path, text, below=None):
    tags = [] if below is None else [(37520, "s", 0, below, True)]
    tifffile.imwrite(path, COUNTS, datetime=text, extratags=tags)
    return stamp(only_source(path)).taken_s


def hdf5(path, of_file=None, **attributes):
    with h5py.File(path, "w") as file:
        file["frames"] = COUNTS
        file.attrs.update(of_file or {})
        file["frames"].attrs.update(attributes)
    return stamp(only_source(path.with_name(f"{path.name}::frames"))).taken_s


def png(path, *chunks):
    plain = imagecodecs.png_encode(COUNTS)
    parts = [plain[:33]]
    for kind, content in chunks:
        parts.append(struct.pack(">I", len(content)) + kind + content)
        parts.append(struct.pack(">I", zlib.crc32(kind + content)))
    path.write_bytes(b"".join([*parts, plain[33:]]))
    np.testing.assert_array_equal(only_source(path).counts(), COUNTS)
    return stamp(only_source(path)).taken_s


def test_times_of_tiff_tags(tmp_path):
    path = tmp_path / "a.tif"
    assert tiff(path, "2026:03:02 10:00:00") == NOON
    assert tiff(path, "2026:03:02 10:00:00", "000500") == NOON + Decimal("0.0005")
    assert tiff(path, "2026:13:02 10:00:00") is None
    assert stamp(only_source(path)).rounded_to_s == 1


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ({"time": 0.0015}, Decimal("0.0015")),
        ({"t": np.float32(0.5)}, Decimal("0.5")),
        ({"timestamp": 1772445600.0005}, NOON + Decimal("0.0005")),
        ({"time_us": 1500}, Decimal("0.0015")),
        ({"Timestamp_ns": np.uint64(500_000)}, Decimal("0.0005")),
        ({"acquisition_time": "2026-03-02T10:00:00.000500"}, NOON + Decimal("0.0005")),
        ({"acquisition_time": "2026-03-02T12:00:00.0005+02:00"}, NOON + Decimal("0.0005")),
        ({"time": np.bytes_(b"2026-03-02 10:00:00")}, NOON),
        ({"time": "noon"}, None),
        ({"time": float("nan")}, None),
        ({"timestamp": 123456789}, None),  # ticks of an unknown clock
        ({"exposure": 0.001}, None),
        ({"time": np.arange(3.0)}, None),
    ],
)
def test_times_of_hdf5_attributes(tmp_path, attributes, expected):
    assert hdf5(tmp_path / "a.h5", **attributes) == expected
    assert hdf5(tmp_path / "b.h5", of_file=attributes) == expected


def test_each_image_of_a_stack_has_its_own_time(tmp_path):
    with h5py.File(tmp_path / "film.h5", "w") as file:
        file["frames"] = np.stack([COUNTS, COUNTS + 1, COUNTS + 2])
        file["frames"].attrs["time_s"] = [0.0, 0.0005, 0.0015]
    marks = [(source.name, stamp(source)) for source in sources_of(tmp_path / "film.h5::frames")]
    assert [float(mark.taken_s) for _, mark in marks] == [0.0, 0.0005, 0.0015]
    found = in_order(marks, 0.0005)
    assert found.name == "uneven-times"
    assert "frames are 0.0005 to 0.001 s apart by their times, recording.dt_s is 0.0005" in found.words


def test_times_of_png_files(tmp_path):
    path = tmp_path / "a.png"
    assert png(path) is None
    assert png(path, (b"tIME", struct.pack(">H5B", 2026, 3, 2, 10, 0, 0))) == NOON
    text = b"Creation Time\0" + b"2026-03-02T10:00:00.25"
    assert png(path, (b"tEXt", text), (b"tIME", bytes(7))) == NOON + Decimal("0.25")
    assert png(path, (b"tEXt", b"Creation Time\0yesterday")) is None
    path.write_bytes(path.read_bytes()[:40])  # cut within a chunk: the pixels are refused elsewhere
    assert stamp(only_source(path)).taken_s is None


def marks(*times):
    stamps = [Stamp(None if t is None else Decimal(str(t)), {}, Decimal("0.0001")) for t in times]
    return [(f"{k}.tif", each) for k, each in enumerate(stamps)]


TWO = ((0, 1), (2, 3))


@pytest.mark.parametrize(
    ("times", "dt_s", "pairs", "name"),
    [
        ((0, 0.0005, 0.001, 0.0015), 0.0005, (), "order"),
        ((0, 0.0005, 0.001, 0.0015), 0.0006, (), "uneven-times"),
        ((0, 0.0005, 0.001, 0.0015), 0.5, (), "uneven-times"),
        ((0, 0.0005, 0.1, 0.1005), 0.0005, (), "pairs-as-sequence"),
        ((0, 0.0005, 0.1, 0.1005), 0.0005, TWO, "order"),
        ((0, 0.0005, 0.1, 0.1005), 0.005, TWO, "uneven-times"),
        ((0, 0.0005, 0.1, 0.103), 0.0005, TWO, "uneven-times"),
        ((0.1, 0.1005, 0, 0.0005), 0.0005, TWO, "out-of-order"),
        ((0.0005, 0, 0.1, 0.1005), 0.0005, TWO, "out-of-order"),
        ((0.1, 0.1, 0.2, 0.2), 0.0005, TWO, "order"),  # one time for both
        ((0, None, 0.1, None), 0.0005, TWO, "order"),
        ((None, None, 0.1, None), 0.0005, TWO, "order"),
    ],
)
def test_what_times_say(times, dt_s, pairs, name):
    found = in_order(marks(*times), dt_s, pairs)
    assert found.name == name
    severity = {"order": "good", "uneven-times": "warning"}.get(name, "unusable")
    assert found.severity == severity


def test_the_advice_names_the_key():
    as_sequence = in_order(marks(0, 0.0005, 0.1, 0.1005), 0.0005)
    assert "by their times frames are pairs, 0.0005 s apart, with 0.0995 s or more from one pair" in as_sequence.words
    assert as_sequence.advice == "name them in recording.pairs instead of recording.frames"
    assert "in recording.pairs" in in_order(marks(0.0005, 0, 0.1, 0.1005), 0.0005, TWO).advice
    assert "in recording.frames" in in_order(marks(0.0005, 0), 0.0005).advice
    assert "the time between both pulses" in in_order(marks(0, 0.0005, 0.1, 0.103), 0.0005, TWO).advice


def test_stamps_are_taken_as_finely_as_they_are_given():
    """A clock of milliseconds says little of steps of half of one, and seconds say nothing; on average they do."""
    clock = [(f"{k}.tif", Stamp(Decimal(k // 2) / 1000, {}, Decimal("0.001"))) for k in range(40)]
    assert in_order(clock, 0.0005).name == "order"
    assert in_order(clock, 0.0007).name == "uneven-times"
    seconds = [(f"{k}.tif", Stamp(Decimal(k), {}, Decimal(1))) for k in range(4)]
    assert in_order(seconds, 0.0005).name == "order"
