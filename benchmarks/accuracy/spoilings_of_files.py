"""Ways to spoil a recording: its files, their order, what the experiment file says of them, and the flow."""

from __future__ import annotations

import shutil

import tifffile
from small_recording import DT_S
from spoiling import BLACK, MIDDLE, SENSOR, Case, Copy, Spoil, read, write

ORIENTATION_TAG = 274
LENS, ARRAY, PIXELS = "camera.main_lens.", "camera.microlens_array.", "camera.sensor."
UNRELATED = ("unrelated",)
APERTURES = "f-numbers do not match"
FAR = "more than a quarter of the first window"
SAME = ("same-frame",)


def _copied(copy: Copy, pair: int) -> None:
    shutil.copy(copy.frame(pair, "a"), copy.frame(pair, "b"))


def _all_copied(copy: Copy) -> None:
    for pair in range(copy.pairs):
        write(copy.frame(pair, "b"), read(copy.frame(pair, "a")))


def _swapped(copy: Copy) -> None:
    for pair in range(copy.pairs):
        a, b = (tifffile.imread(copy.frame(pair, pulse)) for pulse in "ab")
        write(copy.frame(pair, "a"), b)
        write(copy.frame(pair, "b"), a)


def _swapped_with_times(copy: Copy) -> None:
    _swapped(copy)
    for pair in range(copy.pairs):
        copy.stamp(copy.frame(pair, "a"), 0.1 * pair + DT_S)
        copy.stamp(copy.frame(pair, "b"), 0.1 * pair)


def _ms_with_times(copy: Copy) -> None:
    for pair in range(copy.pairs):
        copy.stamp(copy.frame(pair, "a"), 0.1 * pair)
        copy.stamp(copy.frame(pair, "b"), 0.1 * pair + DT_S)
    copy.key("recording.dt_s", 1e3 * DT_S)


def _displaced(copy: Copy) -> None:
    """The first image was lost: b of a pair, and a of the next."""
    for pair in range(copy.pairs - 1):
        write(copy.frame(pair, "a"), read(copy.frame(pair, "b")))
        write(copy.frame(pair, "b"), read(copy.frame(pair + 1, "a")))
    for path in copy.frames("ab", [copy.pairs - 1]):
        path.unlink()


def _sequence(copy: Copy) -> None:
    copy.key("recording.pairs", None)
    copy.key("recording.frames", "run_*.tif")


def _numbered_sequence(copy: Copy) -> None:
    for n, path in enumerate(copy.frames()):
        path.rename(copy.folder / f"frame_{n:04d}.tif")
    copy.key("recording.pairs", None)
    copy.key("recording.frames", "frame_*.tif")


def _dark_in_sequence(copy: Copy) -> None:
    copy.key("recording.pairs", None)
    copy.key("recording.frames", "*.tif")


def _dark_as_pair(copy: Copy) -> None:
    for path in copy.frames("ab", [MIDDLE]):
        write(path, read(copy.folder / "dark.tif") + copy.rng.normal(0, 1.5, (SENSOR.rows, SENSOR.columns)))


def _truncated(copy: Copy) -> None:
    path = copy.frame(MIDDLE, "a")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _damaged(copy: Copy) -> None:
    path = copy.frame(MIDDLE, "b")
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 2000] = bytes(2000)
    path.write_bytes(data)


def _noise_in_file(copy: Copy) -> None:
    """A part of an uncompressed file overwritten by something else."""

    def overwritten(counts):
        counts[200:400] = copy.rng.integers(0, 4096, counts[200:400].shape)
        return counts

    copy.change(overwritten, "b", [MIDDLE])


def _tagged(copy: Copy, turned: bool, white: bool) -> None:
    paths = copy.frames() + ([copy.white] if white else [])
    for path in paths:
        counts = tifffile.imread(path)
        write(path, counts[::-1, ::-1] if turned else counts, extratags=[(ORIENTATION_TAG, "H", 1, 3, True)])


def _all_turned(copy: Copy) -> None:
    for path in [*copy.frames(), copy.white]:
        write(path, tifffile.imread(path)[::-1, ::-1])


def _together(*changes: tuple[str, float]) -> Spoil:
    def spoil(copy: Copy) -> None:
        for name, factor in changes:
            copy.times(name, factor)

    return spoil


OF_FILES: dict[str, Case] = {
    # files
    "truncated": Case("a file in the middle cut off", _truncated, bad=(MIDDLE,)),
    "damaged": Case("2000 bytes of a file in the middle overwritten", _damaged, bad=(MIDDLE,)),
    "empty file": Case(
        "a file in the middle empty", lambda copy: copy.frame(MIDDLE, "a").write_bytes(b""), bad=(MIDDLE,)
    ),
    "blank": Case(
        "a frame in the middle all black",
        lambda copy: copy.change(lambda c: 0 * c + BLACK, "a", [MIDDLE]),
        bad=(MIDDLE,),
    ),
    "noise in a frame": Case("200 rows of one frame are not the camera's", _noise_in_file, ("unrelated",), (MIDDLE,)),
    "missing": Case("second frame of one pair missing", lambda copy: copy.frame(MIDDLE, "b").unlink()),
    "dark among frames": Case("dark.tif matched by the pattern of frames", _dark_in_sequence),
    "dark pair": Case("frames of one pair without light", _dark_as_pair, ("underexposed",), (MIDDLE,)),
    # order
    "copied": Case("second frame of one pair a copy of the first", lambda copy: _copied(copy, MIDDLE), SAME, (MIDDLE,)),
    "all copied": Case("second frames are copies of the first", _all_copied, SAME),
    "sequence": Case("A/B read as a sequence", _sequence, ("pairs-as-sequence", "reversing")),
    "numbered sequence": Case(
        "the same, frames numbered through", _numbered_sequence, ("pairs-as-sequence", "reversing")
    ),
    "first lost": Case("first image lost: b of a pair, then a of the next", _displaced, UNRELATED),
    "unrelated pair": Case(
        "second frame of one pair is another pair's",
        lambda copy: write(copy.frame(MIDDLE, "b"), read(copy.frame(0, "b"))),
        (*UNRELATED, *SAME),
        (MIDDLE,),
    ),
    "swapped": Case("both frames of each pair swapped", _swapped, silent=True),
    "swapped, times": Case("the same, files bear times", _swapped_with_times, ("out-of-order",)),
    "dt in ms": Case("dt_s in ms", lambda copy: copy.times("recording.dt_s", 1e3), silent=True),
    "dt in ms, times": Case("the same, files bear times", _ms_with_times, ("uneven-times",)),
    # orientation
    "one mirrored": Case(
        "one frame mirrored", lambda copy: copy.change(lambda c: c[:, ::-1], "b", [MIDDLE]), ("flipped",), (MIDDLE,)
    ),
    "all frames mirrored": Case(
        "all frames mirrored, white image not", lambda copy: copy.change(lambda c: c[:, ::-1]), ("flipped",)
    ),
    "orientation": Case("all images turned by 180 degrees", _all_turned, silent=True),
    "tag": Case(
        "TIFF tag: turned by 180 degrees, of all images",
        lambda c: _tagged(c, turned=True, white=True),
        ("orientation-tag",),
    ),
    "tag of frames": Case(
        "the same, of frames alone", lambda c: _tagged(c, turned=True, white=False), ("orientation-tag", "flipped")
    ),
    # keys
    "black level 0": Case(
        "black_level = 0 for 60", lambda c: c.key(PIXELS + "black_level", 0.0), ("background", "black-level")
    ),
    "black level 90": Case("black_level = 90 for 60", lambda c: c.key(PIXELS + "black_level", 90.0), ("black-level",)),
    "magnification": Case(
        "magnification +5 %",
        lambda c: c.times(LENS + "magnification", 1.05),
        ("stated-aperture", "f-number"),
        says=APERTURES,
    ),
    "pixel pitch": Case(
        "pixel pitch +5 %",
        lambda c: c.times(PIXELS + "pixel_pitch_mm", 1.05),
        ("lattice-pitch", "no-lattice", "f-number"),
    ),
    "magnification and pixel pitch": Case(
        "both +5 %",
        _together((LENS + "magnification", 1.05), (PIXELS + "pixel_pitch_mm", 1.05)),
        ("lattice-pitch", "no-lattice", "f-number", "stated-aperture"),
        says=APERTURES,
        silent=True,
    ),
    "microlens pitch": Case(
        "pitch of the microlenses +1.5 %", lambda c: c.times(ARRAY + "pitch_mm", 1.015), ("lattice-pitch",)
    ),
    "microlens f": Case(
        "focal length of the microlenses +20 %",
        lambda c: c.times(ARRAY + "focal_length_mm", 1.2),
        ("f-number", "stated-aperture"),
        says=APERTURES,
    ),
    "microlens f and aperture": Case(
        "the same, aperture to match",
        _together((ARRAY + "focal_length_mm", 1.2), (LENS + "aperture_mm", 1 / 1.2)),
        silent=True,
    ),
    "aperture": Case(
        "aperture +10 %", lambda c: c.times(LENS + "aperture_mm", 1.1), ("f-number", "stated-aperture"), says=APERTURES
    ),
    "lattice": Case("square lattice stated", lambda c: c.key(ARRAY + "lattice", "square"), ("lattice-type",)),
    "bit depth": Case("16 bits stated for 12", lambda c: c.key(PIXELS + "bit_depth", 16), ("white-underexposed",)),
    "half volume": Case(
        "volume half as deep as the light", lambda c: c.key("volume.z_mm", [-1.25, 1.25]), ("unexplained-light",)
    ),
    "other volume": Case(
        "volume beside the light",
        lambda c: c.key("volume.z_mm", [2.6, 5.0]),
        ("unexplained-light",),
    ),
    # flow and seeding
    "fast": Case(
        "35 voxels per frame, where 24 are searched",
        lambda copy: None,
        ("displacement-too-large",),
        says=FAR,
        base="fast",
        pairs=1,
    ),
    "thin": Case("seeding of 0.1 particles per microlens", lambda copy: None, ("too-thin",), base="thin", pairs=1),
    "dense": Case("seeding of 6 particles per microlens", lambda copy: None, ("too-dense",), base="dense", pairs=1),
}
