"""TIFF files whose header contradicts itself, or asks for more than the file holds: one line, and no memory."""

import resource
import struct

import numpy as np
import pytest
import tifffile

from plenopiv.errors import PlenoPIVError
from plenopiv.recording import image_size, read_image
from plenopiv.recording.sources import sources_of

COUNTS = np.random.default_rng(1).integers(55, 900, (40, 60)).astype(np.uint16)
# Codes of tags in a TIFF file's directory.
TAGS = {"width": 256, "length": 257, "bits": 258, "rows": 278, "tile_width": 322, "tile_length": 323, "format": 339}
TAGS |= {"depth": 32997}
SOFTWARE = 305


def entries(content):
    """Offset of each entry of the first directory by its tag; the file is little-endian."""
    (first,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, first)
    return {struct.unpack_from("<H", content, at)[0]: at for at in range(first + 2, first + 2 + 12 * count, 12)}


def spoilt(path, **tags):
    """Set values of tags; one that the file does not have takes the place of the software's name."""
    content = bytearray(path.read_bytes())
    for name, value in tags.items():
        at = entries(content)[SOFTWARE if TAGS[name] not in entries(content) else TAGS[name]]
        tag = TAGS[name]
        struct.pack_into("<HHII", content, at, tag, 4, 1, value)
    path.write_bytes(content)
    return path


def refused(path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for read in (read_image, image_size):
        with pytest.raises(PlenoPIVError) as caught:
            read(path)
        message = str(caught.value)
        assert message.startswith(f"{path}: ")
        assert "\n" not in message
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000
    return message


def test_an_image_of_several_slices(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, COUNTS, software="camera")
    assert image_size(path) == (60, 40)
    assert "is a volume of 2 slices (image depth), not an image" in refused(spoilt(path, depth=2))
    tifffile.imwrite(path, np.stack([COUNTS] * 2), volumetric=True, tile=(1, 16, 16))
    assert "is a volume of 2 slices (image depth), not an image" in refused(path)


def test_a_stack_of_imagej_whose_directory_names_one_image(tmp_path):
    """As ImageJ writes it above 4 GB: it counted as its first image."""
    path, stack = tmp_path / "a.tif", np.stack([COUNTS + n for n in range(5)])
    tifffile.imwrite(path, stack, imagej=True, truncate=True)
    assert refused(path) == (
        f"{path}: is a stack of 5 images as ImageJ writes above 4 GB, of which its directory names the first alone; "
        "save it as separate images, or as a BigTIFF"
    )
    tifffile.imwrite(path, stack, imagej=True)
    assert [int(one.counts().max()) for one in sources_of(path)] == [int(COUNTS.max()) + n for n in range(5)]


def test_an_image_with_the_words_of_its_stack_is_one(tmp_path):
    path = tmp_path / "a.tif"
    for words in ("ImageJ=1.53t\nimages=5\nslices=5\n", "ImageJ=1.53t\nimages=many\n"):
        tifffile.imwrite(path, COUNTS, description=words, metadata=None)
        np.testing.assert_array_equal(read_image(path), COUNTS)
    tifffile.imwrite(path, COUNTS, imagej=True)
    np.testing.assert_array_equal(read_image(path), COUNTS)


@pytest.mark.parametrize("compression", ["adobe_deflate", "lzw", "zstd", "packbits"])
def test_more_pixels_than_a_file_can_unpack_to(tmp_path, compression):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, COUNTS, compression=compression)
    message = refused(spoilt(path, width=60000, length=40000, rows=40000))
    assert "states 60000 x 40000 pixels, 4.8e+03 MB" in message


def test_tiles_larger_than_their_image(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, COUNTS, tile=(48, 64), compression="adobe_deflate")
    assert "MB of strips or tiles" in refused(spoilt(path, tile_width=65536, tile_length=65536))


@pytest.mark.parametrize(
    "tags",
    [
        {"bits": 0},
        {"bits": 2**31},
        {"format": 77},
        {"rows": 0},
        {"width": 0},
        {"length": 0},
        {"length": 2**32 - 1},
        {"width": 2**32 - 1, "length": 2**32 - 1},
    ],
)
def test_numbers_that_no_image_has(tmp_path, tags):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, COUNTS, compression="adobe_deflate", software="camera")
    refused(spoilt(path, **tags))
