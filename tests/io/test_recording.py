"""Images: what is read, and the one line that each bad file gets. No missing strip may turn into zeros."""

import os
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import tifffile

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.recording import ImageSource, Recording, find_frames, natural_order, read_image
from plenopiv.sensor import Sensor

SENSOR = Sensor(60, 40, 0.0055, 12, 60.0)


@pytest.fixture
def counts():
    return np.random.default_rng(1).integers(55, 900, (SENSOR.rows, SENSOR.columns)).astype(np.uint16)


def write(path, image, **options):
    tifffile.imwrite(path, image, **options)
    return path


def refused(path, sensor=SENSOR):
    with pytest.raises(PlenoPIVError) as caught:
        read_image(path, sensor)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def test_frames_may_be_named_by_text(tmp_path, counts):
    names = [str(write(tmp_path / f"{letter}.tif", counts)) for letter in "ab"]
    recording = Recording(SENSOR, names, None, 1e-3, "upright")
    np.testing.assert_array_equal(recording.frame(1), counts)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "lzw"},
        {"compression": "adobe_deflate", "predictor": True},
        {"bigtiff": True},
        {"tile": (16, 16)},
    ],
)
def test_counts_come_back_as_they_were_written(tmp_path, counts, options):
    read = read_image(write(tmp_path / "a.tif", counts, **options), SENSOR)
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, counts)


def test_frames_of_several_folders_have_names_of_their_own(tmp_path, counts):
    (tmp_path / "A").mkdir()
    (tmp_path / "B").mkdir()
    paths = [write(tmp_path / name, counts) for name in ("A/001.tif", "B/001.tif", "A/002.tif")]
    recording = Recording(SENSOR, tuple(paths), None, 1e-3, "upright")
    assert recording.names == ["A/001.tif", "B/001.tif", "002.tif"]


def test_the_first_and_the_last_pair_that_can_be_read(tmp_path, counts):
    """A blank frame is found when it is read."""
    images = [0 * counts, counts, counts, counts, 0 * counts]
    paths = [write(tmp_path / f"{k}.tif", image) for k, image in enumerate(images)]
    recording = Recording(SENSOR, tuple(paths), None, 1e-3, "upright")
    (first, before), (last, after) = recording.first_readable_pair(), recording.last_readable_pair()
    assert (first, last) == ((1, 2), (2, 3))
    assert (list(before), list(after)) == ([0], [4])
    assert "is blank" in after[4]


def test_frames_come_upright(tmp_path, counts):
    paths = (write(tmp_path / "a.tif", counts), write(tmp_path / "b.tif", counts + 1))
    white = write(tmp_path / "white.tif", counts + 2)
    as_stored = Recording(SENSOR, paths, white, 1e-3, "upright")
    turned = Recording(SENSOR, paths, white, 1e-3, "sensor")
    np.testing.assert_array_equal(as_stored.frame(1), counts + 1)
    np.testing.assert_array_equal(turned.frame(0)[0, 0], counts[-1, -1])
    np.testing.assert_array_equal(turned.frame(0), counts[::-1, ::-1])
    np.testing.assert_array_equal(turned.white(), counts[::-1, ::-1] + 2)
    assert len(turned) == 2
    assert Recording(SENSOR, paths, None, 1e-3, "upright").white() is None


def test_a_missing_file_a_folder_and_an_empty_file(tmp_path):
    assert refused(tmp_path / "none.tif").endswith("none.tif: no such file; correct its name, or put it there")
    (tmp_path / "white_1.tif").touch()
    assert refused(tmp_path / "white1.tif").endswith("no such file; did you mean white_1.tif?")
    assert refused(tmp_path / "gone" / "a.tif").endswith(f"; there is no folder {tmp_path / 'gone'}: correct its name")
    assert "cannot be read" in refused(tmp_path)
    empty = tmp_path / "empty.tif"
    empty.touch()
    assert "is empty (0 bytes)" in refused(empty)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such pipes")
def test_a_pipe_is_not_waited_for(tmp_path):
    pipe = tmp_path / "a.tif"
    os.mkfifo(pipe)
    writer = os.open(pipe, os.O_RDWR)  # who opens it does not wait, and reads these
    os.write(writer, b"II*\0" + bytes(12))
    try:
        assert "a.tif: is a pipe or a device; copy the image into a file" in refused(pipe)
        assert "is a pipe" in refused(Path("/dev/null"))
    finally:
        os.close(writer)


@pytest.mark.parametrize("name", ["a.tif", "a.png", "a.npy", "a.h5"])
def test_a_file_that_has_gone_is_missing_not_damaged(tmp_path, name):
    source = ImageSource(tmp_path / name, dataset="images" if name == "a.h5" else "")
    for read in (source.size, source.values, source.counts):
        with pytest.raises(PlenoPIVError, match=rf"{name}: is missing$"):
            read()


def test_what_is_no_tiff_says_that_only_tiff_is_read(tmp_path):
    """And the other formats, each by its own ending."""
    path = tmp_path / "a.tif"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    assert "no image file that is known; TIFF, PNG, NumPy" in refused(path)


@pytest.mark.parametrize("options", [{}, {"compression": "lzw"}, {"rowsperstrip": 4}, {"tile": (16, 16)}])
@pytest.mark.parametrize("kept", [0.3, 0.7, 0.98])
def test_a_truncated_file_is_refused(tmp_path, counts, options, kept):
    path = write(tmp_path / "a.tif", counts, **options)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    assert any(word in refused(path) for word in ("truncated", "damaged", "incomplete"))


def test_a_strip_of_no_bytes_is_refused_where_the_reader_gives_zeros(tmp_path, counts):
    path = write(tmp_path / "a.tif", counts, rowsperstrip=10)
    with tifffile.TiffFile(path) as tif:
        tag = tif.pages[0].tags["StripByteCounts"]
        at, strips, width = tag.valueoffset, tag.count, {3: 2, 4: 4}[tag.dtype]
    content = bytearray(path.read_bytes())
    struct.pack_into("<H" if width == 2 else "<I", content, at + width * (strips - 1), 0)
    path.write_bytes(content)
    assert not tifffile.imread(path)[-10:].any()  # what this guards against
    assert f"1 of {strips} strips have no pixels" in refused(path)


def test_damaged_compressed_pixels_are_refused(tmp_path, counts):
    path = write(tmp_path / "a.tif", counts, compression="adobe_deflate")
    with tifffile.TiffFile(path) as tif:
        page = tif.pages[0]
        middle = page.dataoffsets[0] + page.databytecounts[0] // 2
    content = bytearray(path.read_bytes())
    content[middle : middle + 40] = bytes(40)
    path.write_bytes(content)
    assert "damaged" in refused(path)


def test_another_size_names_both(tmp_path, counts):
    message = refused(write(tmp_path / "a.tif", counts[:, :-2]))
    assert "58 x 40" in message
    assert "60 x 40" in message


def test_a_header_that_claims_a_huge_image_allocates_nothing(tmp_path, counts):
    path = write(tmp_path / "a.tif", counts)
    with tifffile.TiffFile(path, mode="r+b") as tif:
        tif.pages[0].tags["ImageWidth"].overwrite(65535)
        tif.pages[0].tags["ImageLength"].overwrite(65535)
    assert "65535 x 65535" in refused(path)
    assert "incomplete" in refused(path, Sensor(65535, 65535, 0.0055, 12))  # 8 GB of zeros for a reader that trusts it


def test_values_above_full_scale_are_a_contradiction(tmp_path, counts):
    counts[3, 4] = 5001
    assert "5001, above full scale of 12 bits, 4095; set camera.sensor.bit_depth" in refused(
        write(tmp_path / "a.tif", counts)
    )


def test_left_aligned_counts_are_recognised(tmp_path, counts):
    assert "multiples of 16" in refused(write(tmp_path / "a.tif", counts << 4))


def test_eight_bit_files_of_a_deeper_sensor_are_refused(tmp_path, counts):
    path = write(tmp_path / "a.tif", (counts >> 4).astype(np.uint8))
    assert "holds 8 bits per pixel, but camera.sensor.bit_depth is 12" in refused(path)
    eight = Sensor(60, 40, 0.0055, 8)
    assert read_image(path, eight).dtype == np.uint16


def test_colour_images_are_refused(tmp_path, counts):
    rgb = write(tmp_path / "rgb.tif", np.stack([counts] * 3, -1), photometric="rgb")
    assert "colour cameras are not supported" in refused(rgb)
    assert "Bayer" in refused(rgb)
    palette = np.zeros((3, 256), np.uint16)
    indexed = write(tmp_path / "p.tif", counts.astype(np.uint8), photometric="palette", colormap=palette)
    assert "colour" in refused(indexed)
    cfa = write(tmp_path / "cfa.tif", counts, photometric="cfa")
    assert "Bayer" in refused(cfa)
    inverted = write(tmp_path / "w.tif", counts, photometric="miniswhite")
    assert "white as 0" in refused(inverted)


def test_floats_are_refused_nan_or_not(tmp_path, counts):
    image = counts.astype(np.float32)
    image[0, 0] = np.nan
    assert "holds float32 values" in refused(write(tmp_path / "a.tif", image))


def test_several_pages_are_refused(tmp_path, counts):
    path = write(tmp_path / "a.tif", np.stack([counts, counts]), photometric="minisblack")
    assert "holds 2 images, wanted one" in refused(path)


def test_a_blank_image_is_refused(tmp_path, counts):
    assert "every pixel is 60" in refused(write(tmp_path / "a.tif", np.full_like(counts, 60)))


def test_one_frame_is_too_few(tmp_path, counts):
    with pytest.raises(PlenoPIVError, match="1 frame"):
        Recording(SENSOR, (write(tmp_path / "a.tif", counts),), None, 1e-3, "upright")


def test_a_recording_checks_all_its_files_at_once(tmp_path, counts):
    good, bad = write(tmp_path / "a.tif", counts), write(tmp_path / "b.tif", counts[1:])
    with pytest.raises(PlenoPIVError, match=r"b\.tif"):
        Recording(SENSOR, (good, bad), None, 1e-3, "upright")
    with pytest.raises(PlenoPIVError, match=r"white\.tif: no such file"):
        Recording(SENSOR, (good, good), tmp_path / "white.tif", 1e-3, "upright")


def test_the_white_image_is_no_frame(tmp_path, counts):
    paths = (write(tmp_path / "a.tif", counts), write(tmp_path / "b.tif", counts))
    with pytest.raises(PlenoPIVError, match=r"b\.tif: is named both in recording\.white and in recording\.frames"):
        Recording(SENSOR, paths, paths[1], 1e-3, "upright")


def test_saturation_is_warned_about_above_its_limit(tmp_path, counts):
    # 2400 pixels: none may be saturated at 0.01 %
    paths = (write(tmp_path / "a.tif", counts), write(tmp_path / "b.tif", np.where(counts > 890, 4095, counts)))
    recording = Recording(SENSOR, paths, None, 1e-3, "upright")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording.frame(0)
    with pytest.warns(PlenoPIVWarning, match=r"b\.tif: .* % of the pixels are saturated"):
        recording.frame(1)


def test_globs_follow_numbers_and_leave_the_white_image_out(tmp_path):
    for name in ("a10.tif", "a2.tif", "white.tif", "notes.txt"):
        (tmp_path / name).touch()
    found = find_frames(tmp_path, "*.tif", leave_out=tmp_path / "white.tif")
    assert [p.name for p in found] == ["a2.tif", "a10.tif"]
    assert find_frames(tmp_path, str(tmp_path / "a*.tif")) == found
    with pytest.raises(PlenoPIVError, match=r"no file matches '\*\.png'"):
        find_frames(tmp_path, "*.png")


def test_hidden_files_are_no_frames(tmp_path):
    """A Mac lays "._a.tif" beside "a.tif" on disks of others."""
    for name in ("a1.tif", "a2.tif", "._a1.tif", ".a3.tif"):
        (tmp_path / name).touch()
    assert [p.name for p in find_frames(tmp_path, "*.tif")] == ["a1.tif", "a2.tif"]
    assert [p.name for p in find_frames(tmp_path, "*1.tif")] == ["a1.tif"]
    assert [p.name for p in find_frames(tmp_path, ".a*.tif")] == [".a3.tif"]


def test_natural_order():
    assert sorted(["f10", "f9b2", "f9b10", "F1"], key=natural_order) == ["F1", "f9b2", "f9b10", "f10"]


@pytest.mark.parametrize("dt_s", [0.0, -1e-3, np.nan, np.inf])
def test_a_time_that_is_not_positive_is_refused(tmp_path, counts, dt_s):
    paths = tuple(write(tmp_path / f"{name}.tif", counts) for name in "ab")
    with pytest.raises(PlenoPIVError, match=rf"recording.dt_s: {dt_s} is no time between frames; give a positive"):
        Recording(SENSOR, paths, None, dt_s, "upright")


def test_an_unknown_orientation_is_refused_before_files_are_looked_at(tmp_path):
    paths = tmp_path / "a.tif", tmp_path / "b.tif"
    with pytest.raises(PlenoPIVError, match=r"recording.orientation: 'up' is no orientation; give"):
        Recording(SENSOR, paths, None, 1e-3, "up")
