"""The same counts from every kind of file, and which images of a recording belong together."""

import h5py
import imagecodecs
import numpy as np
import pytest
import tifffile

from plenopiv.errors import PlenoPIVError
from plenopiv.recording import ImageSource, Recording, read_image
from plenopiv.recording.formats import image_datasets
from plenopiv.recording.pairs import pairs, sequence
from plenopiv.recording.sources import only_source, sources_of
from plenopiv.sensor import Sensor

SENSOR = Sensor(60, 40, 0.0055, 12, 60.0)


@pytest.fixture
def counts():
    return np.random.default_rng(1).integers(55, 900, (SENSOR.rows, SENSOR.columns)).astype(np.uint16)


def png(path, image):
    path.write_bytes(imagecodecs.png_encode(image))


def hdf5(path, image):
    with h5py.File(path, "w") as file:
        file.create_dataset("run/images", data=image, chunks=True, compression="gzip")


WRITERS = {
    "plain.tif": lambda p, i: tifffile.imwrite(p, i),
    "big.tif": lambda p, i: tifffile.imwrite(p, i, bigtiff=True),
    "motorola.tif": lambda p, i: tifffile.imwrite(p, i, byteorder=">"),
    "tiled.tif": lambda p, i: tifffile.imwrite(p, i, tile=(16, 16)),
    **{
        f"{how}.tif": lambda p, i, how=how: tifffile.imwrite(p, i, compression=how, rowsperstrip=7)
        for how in ("lzw", "adobe_deflate", "packbits", "zstd", "lzma")
    },
    "predicted.tif": lambda p, i: tifffile.imwrite(p, i, compression="lzw", predictor=True),
    "image.png": png,
    "image.npy": np.save,
    "image.h5": hdf5,
    "big-endian.npy": lambda p, i: np.save(p, i.astype(i.dtype.newbyteorder(">"))),
    "big-endian.h5": lambda p, i: hdf5(p, i.astype(i.dtype.newbyteorder(">"))),
}


def written(folder, name, image):
    path = folder / name
    WRITERS[name](path, image)
    return folder / (f"{name}::run/images" if name.endswith("h5") else name)


@pytest.mark.parametrize("name", WRITERS)
def test_counts_are_the_same_from_every_file(tmp_path, counts, name):
    read = read_image(written(tmp_path, name, counts), SENSOR)
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, counts)


@pytest.mark.parametrize("order", "<>")
def test_data_sets_of_either_order_of_bytes_are_images(tmp_path, counts, order):
    hdf5(tmp_path / "image.h5", counts.astype(counts.dtype.newbyteorder(order)))
    assert image_datasets(tmp_path / "image.h5") == ["run/images"]


@pytest.mark.parametrize("name", WRITERS)
def test_eight_bits_from_every_file(tmp_path, counts, name):
    eight = (counts >> 4).astype(np.uint8)
    read = read_image(written(tmp_path, name, eight), Sensor(60, 40, 0.0055, 8, 3.0))
    np.testing.assert_array_equal(read, eight)


@pytest.mark.parametrize("name", WRITERS)
def test_another_size_is_refused_by_name(tmp_path, counts, name):
    path = written(tmp_path, name, counts[:, :-2])
    with pytest.raises(PlenoPIVError, match=r"is 58 x 40 pixels \(columns x rows\), but camera\.sensor says 60 x 40"):
        read_image(path, SENSOR)


def test_counts_in_the_upper_bits(tmp_path, counts):
    high = Sensor(60, 40, 0.0055, 12, 60.0, "high")
    tifffile.imwrite(tmp_path / "high.tif", counts << 4)
    np.testing.assert_array_equal(read_image(tmp_path / "high.tif", high), counts)
    tifffile.imwrite(tmp_path / "low.tif", counts | 1)
    with pytest.raises(PlenoPIVError, match=r'no multiples of 16.*remove camera\.sensor\.alignment = "high"'):
        read_image(tmp_path / "low.tif", high)
    with pytest.raises(PlenoPIVError, match=r'in the upper bits: set camera\.sensor\.alignment = "high"'):
        read_image(tmp_path / "high.tif", SENSOR)


def test_the_mean_of_many_images_in_the_upper_bits_is_rounded(tmp_path, counts):
    """As a dark image often is, which fills the bits below the camera's; full scale stays full scale."""
    high = Sensor(60, 40, 0.0055, 12, 60.0, "high")
    counts[0, :2] = 4095, 0
    fraction = np.random.default_rng(2).integers(-8, 8, counts.shape)
    tifffile.imwrite(tmp_path / "dark.tif", np.clip(counts * 16 + fraction, 0, 65535).astype(np.uint16))
    np.testing.assert_array_equal(ImageSource(tmp_path / "dark.tif").counts(high, mean=True), counts)
    with pytest.raises(PlenoPIVError, match="no multiples of 16"):
        ImageSource(tmp_path / "dark.tif").counts(high)


@pytest.mark.parametrize("name", ["stack.tif", "stack.npy", "stack.h5"])
def test_pages_and_stacks_are_images_in_turn(tmp_path, counts, name):
    images = np.stack([counts + k for k in range(4)])
    path = tmp_path / name
    {"tif": lambda: tifffile.imwrite(path, images, photometric="minisblack"), "npy": lambda: np.save(path, images)}.get(
        name[6:], lambda: hdf5(path, images)
    )()
    found = sources_of(tmp_path / (f"{name}::run/images" if name.endswith("h5") else name))
    assert [source.page for source in found] == [0, 1, 2, 3]
    assert found[2].name.endswith("page 3")
    for k, source in enumerate(found):
        np.testing.assert_array_equal(source.counts(SENSOR), counts + k)
    with pytest.raises(PlenoPIVError, match="holds 4 images, wanted one"):
        only_source(tmp_path / (f"{name}::run/images" if name.endswith("h5") else name))


REFUSED = {
    "colour.npy": (lambda p, i: np.save(p, np.stack([i] * 3, -1)), "is a colour image"),
    "floats.npy": (lambda p, i: np.save(p, i * 1.0), "holds float64 values"),
    "line.npy": (lambda p, i: np.save(p, i[0]), r"an array of shape \(60,\)"),
    "cut.npy": (lambda p, i: (np.save(p, i), p.write_bytes(p.read_bytes()[:-500])), "is no whole NumPy file"),
    "objects.npy": (lambda p, i: np.save(p, np.array([{}])), "is no whole NumPy file"),
    "colour.png": (lambda p, i: png(p, np.stack([i] * 3, -1)), "is a colour image"),
    "cut.png": (lambda p, i: (png(p, i), p.write_bytes(p.read_bytes()[:-900])), "do not decode"),
    "text.png": (lambda p, i: p.write_text("no image at all, but a text"), "is no PNG file"),
    "text.h5": (lambda p, i: p.write_text("no image at all"), "is no whole HDF5 file"),
    "unnamed.h5": (hdf5, r"names no data set; write unnamed\.h5::NAME, it holds run/images"),
    "buffer.im7": (lambda p, i: p.write_bytes(bytes(99)), r"pip install plenopiv\[lavision\]|cannot be read by lvpyio"),
    "slices.tif": (
        lambda p, i: tifffile.imwrite(p, np.stack([i] * 16), volumetric=True, tile=(16, 16, 16)),
        "is a volume of 16 slices",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_image_is_refused_in_one_line(tmp_path, counts, name):
    write, why = REFUSED[name]
    write(tmp_path / name, counts)
    with pytest.raises(PlenoPIVError, match=why) as caught:
        read_image(tmp_path / name, SENSOR)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert "\n" not in str(caught.value)


def names(frames, of_pairs):
    return [(frames[a].name, frames[b].name) for a, b in of_pairs]


def touched(folder, *file_names):
    for name in file_names:
        tifffile.imwrite(folder / name, np.arange(2400, dtype=np.uint16).reshape(40, 60))


def test_braces_name_both_pulses_of_each_pair(tmp_path):
    touched(tmp_path, "run_10_a.tif", "run_10_b.tif", "run_2_b.tif", "run_2_a.tif", "white.tif")
    found = names(*pairs(tmp_path, "run_*_{a,b}.tif"))
    assert found == [("run_2_a.tif", "run_2_b.tif"), ("run_10_a.tif", "run_10_b.tif")]
    # a wildcard on both sides, and braces in the middle of a word
    touched(tmp_path, "B00001A-x.tif", "B00001B-x.tif")
    assert names(*pairs(tmp_path, "B*{A,B}-*.tif")) == [("B00001A-x.tif", "B00001B-x.tif")]
    assert names(*pairs(tmp_path, "run_2_{a,b}.tif")) == [("run_2_a.tif", "run_2_b.tif")]


def test_a_pulse_without_its_partner_is_an_error(tmp_path):
    touched(tmp_path, "run_1_a.tif", "run_1_b.tif", "run_2_a.tif")
    with pytest.raises(PlenoPIVError, match=r"run_2_a\.tif has no partner"):
        pairs(tmp_path, "run_*_{a,b}.tif")


def test_listed_pairs_and_patterns_that_are_none(tmp_path):
    touched(tmp_path, "p.tif", "q.tif", "r.tif")
    assert names(*pairs(tmp_path, [("q.tif", "p.tif"), ("r.tif", "q.tif")])) == [("q.tif", "p.tif"), ("r.tif", "q.tif")]
    with pytest.raises(PlenoPIVError, match="holds 1 image"):
        pairs(tmp_path, "*.tif")
    with pytest.raises(PlenoPIVError, match="give one pair of braces"):
        pairs(tmp_path, "{p,q}{r,s}.tif")


def test_pages_are_pairs_and_stacked_images_hold_both(tmp_path, counts):
    images = np.stack([counts + k for k in range(4)])
    tifffile.imwrite(tmp_path / "run_1.tif", images, photometric="minisblack")
    frames, of_pairs = pairs(tmp_path, "run_*.tif")
    assert of_pairs == ((0, 1), (2, 3))
    np.testing.assert_array_equal(frames[3].counts(SENSOR), counts + 3)
    tall = tmp_path / "tall"
    tall.mkdir()
    tifffile.imwrite(tall / "x.tif", np.concatenate([counts, counts + 5]))
    for stacked, first in (("top-first", 0), ("bottom-first", 5)):
        frames, of_pairs = pairs(tall, "*.tif", stacked)
        assert of_pairs == ((0, 1),)
        np.testing.assert_array_equal(frames[0].counts(SENSOR), counts + first)
        np.testing.assert_array_equal(frames[1].counts(SENSOR), counts + 5 - first)
    assert isinstance(frames[0], ImageSource)
    with pytest.raises(PlenoPIVError, match=r"camera\.sensor says 60 x 40 \(both pulses stacked\)"):
        Recording(SENSOR, pairs(tmp_path, "run_*.tif", "top-first")[0], None, 1e-3, "upright")


def test_pages_of_one_file_are_a_sequence(tmp_path, counts):
    tifffile.imwrite(tmp_path / "film.tif", np.stack([counts, counts + 1, counts + 2]), photometric="minisblack")
    recording = Recording(SENSOR, sequence(tmp_path, "film.tif"), None, 1e-3, "upright")
    assert recording.pairs == ((0, 1), (1, 2))
    assert recording.is_sequence
    assert [recording.pulse(k) for k in range(3)] == [0, 0, 0]
    touched(tmp_path, "more.tif")
    with pytest.raises(PlenoPIVError, match=r"more\.tif: holds 1 images, film\.tif 3"):
        sequence(tmp_path, "*.tif")


@pytest.mark.parametrize("named", ["run.h5::pulse_{a,b}", [("run.h5::pulse_a", "run.h5::pulse_b")]])
def test_two_data_sets_hold_the_pulses_of_many_pairs(tmp_path, counts, named):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["pulse_a"] = np.stack([counts, counts + 1, counts + 2])
        file["pulse_b"] = np.stack([counts + 10, counts + 11, counts + 12])
        file["pulse_c"] = np.stack([counts, counts])
    frames, of_pairs = pairs(tmp_path, named)
    assert of_pairs == ((0, 1), (2, 3), (4, 5))
    for (first, second), k in zip(of_pairs, range(3), strict=True):
        np.testing.assert_array_equal(frames[first].counts(SENSOR), counts + k)
        np.testing.assert_array_equal(frames[second].counts(SENSOR), counts + 10 + k)
    with pytest.raises(PlenoPIVError, match=r"run\.h5::pulse_c: holds 2 image\(s\), run\.h5::pulse_a 3; both pulses"):
        pairs(tmp_path, "run.h5::pulse_{a,c}")


def test_a_damaged_stack_of_pulses_is_named(tmp_path, counts):
    tifffile.imwrite(tmp_path / "a.tif", np.stack([counts, counts]), photometric="minisblack")
    (tmp_path / "b.tif").write_bytes((tmp_path / "a.tif").read_bytes()[:6])
    with pytest.raises(PlenoPIVError, match=r"b\.tif: its TIFF header cannot be read"):
        pairs(tmp_path, [("a.tif", "b.tif")])


def with_thumbnails(path, images, first=False, marked=1):
    """A file of ``images``, each followed (or ``first``: preceded) by a thumbnail that its header marks."""
    with tifffile.TiffWriter(path) as tif:
        for image in images:
            every = [(image, 0), (image[::4, ::4], marked)]
            for page, kind in reversed(every) if first else every:
                tif.write(page, subfiletype=kind, photometric="minisblack", metadata=None)


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("marked", [1, 3])
def test_thumbnails_are_no_images(tmp_path, counts, first, marked):
    for k in range(3):
        with_thumbnails(tmp_path / f"{k}.tif", [counts + k], first, marked)
    with_thumbnails(tmp_path / "film.tif", [counts, counts + 1], first, marked)
    assert Recording(SENSOR, sequence(tmp_path, "[0-9].tif"), None, 1e-3, "upright").pairs == ((0, 1), (1, 2))
    np.testing.assert_array_equal(read_image(tmp_path / "2.tif", SENSOR), counts + 2)
    two = sources_of(tmp_path / "film.tif")
    assert [source.page for source in two] == [0, 1]
    np.testing.assert_array_equal(two[1].counts(SENSOR), counts + 1)


def test_pages_are_images_where_no_other_is_or_no_mark_is_there(tmp_path, counts):
    with_thumbnails(tmp_path / "a.tif", [counts], marked=2)  # a page of several, as fax machines mark them
    assert len(sources_of(tmp_path / "a.tif")) == 2
    tifffile.imwrite(tmp_path / "b.tif", counts, subfiletype=1)
    np.testing.assert_array_equal(read_image(tmp_path / "b.tif", SENSOR), counts)


@pytest.mark.parametrize("damaged", [1, 2])
def test_of_stacks_the_one_that_is_damaged_is_named(tmp_path, counts, damaged):
    for k in (1, 2, 3):
        tifffile.imwrite(tmp_path / f"stack_{k}.tif", np.stack([counts, counts + 1]), photometric="minisblack")
    bad = tmp_path / f"stack_{damaged}.tif"
    bad.write_bytes(bad.read_bytes()[:6])
    with pytest.raises(PlenoPIVError, match=rf"stack_{damaged}\.tif: its TIFF header cannot be read"):
        sequence(tmp_path, "stack_*.tif")
    with pytest.raises(PlenoPIVError, match=r"stack_4\.tif: no such file"):
        sequence(tmp_path, ["stack_3.tif", "stack_4.tif"])


def test_the_second_pulse_of_a_pair_is_known(tmp_path):
    touched(tmp_path, "1a.tif", "1b.tif", "2a.tif", "2b.tif")
    frames, of_pairs = pairs(tmp_path, "*{a,b}.tif")
    recording = Recording(SENSOR, frames, None, 1e-3, "upright", of_pairs)
    assert not recording.is_sequence
    assert [recording.pulse(k) for k in range(4)] == [0, 1, 0, 1]


def test_images_of_one_file_have_stems_of_their_own(tmp_path, counts):
    """Volumes and pictures are written under them: pages of one file must not replace each other."""
    tifffile.imwrite(tmp_path / "film.tif", np.stack([counts, counts + 1]), photometric="minisblack")
    tifffile.imwrite(tmp_path / "tall.tif", np.concatenate([counts, counts]))
    touched(tmp_path, "frame.tif")
    halves = only_source(tmp_path / "tall.tif").halves("top-first")
    found = [source.stem for source in (*sources_of(tmp_path / "film.tif"), *halves)]
    assert found == ["film-1", "film-2", "tall-top", "tall-bottom"]
    assert only_source(tmp_path / "frame.tif").stem == "frame"
