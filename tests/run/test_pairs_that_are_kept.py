"""Which finished pairs are kept when a recording has grown or shrunk since."""

import os
from types import SimpleNamespace

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.run.inputs import changed_frame, frame_entry, read_entry
from plenopiv.run.series import keep_unchanged

INPUTS = {"settings": {"overlap": 0.5}}
CALIBRATED = INPUTS | {"calibration": {}}


def recording_of(folder, pairs):
    """So many pairs, their files not to be found."""
    frames = [SimpleNamespace(name=f"{k}.tif", path=folder / f"{k}.tif") for k in range(2 * pairs)]
    return SimpleNamespace(pairs=tuple((2 * k, 2 * k + 1) for k in range(pairs)), frames=frames)


def finish_one(results, files, set_aside=None):
    """What a run leaves that is ended after its first pair, which wrote ``files``."""
    frames = [{"name": f"{k}.tif", "bytes": None, "mtime_ns": None, "sha256": None} for k in (0, 1)]
    with SeriesFolder(results) as folder:
        folder.begin(INPUTS)
        folder.settle(CALIBRATED)
        for name in files:
            folder.path(name).write_text("a field")
        folder.store({"pair": 0, "frames": frames, "set_aside": set_aside}, files)


def kept(results, recording):
    """Numbers of the finished pairs that the next run keeps."""
    with SeriesFolder(results) as folder:
        folder.begin(INPUTS)
        folder.settle(CALIBRATED)
        assert set(folder.finished) == {0}
        keep_unchanged(folder, recording)
        return list(folder.finished)


ALONE, ONE_OF_SEVERAL = "velocity.nc", "pairs/pair-0000.nc"


@pytest.mark.parametrize(
    ("files", "pairs", "stays"),
    [
        ([ALONE], 1, True),
        ([ALONE], 2, False),  # velocity.nc is to hold all pairs
        ([ONE_OF_SEVERAL], 2, True),
        ([ONE_OF_SEVERAL], 1, False),  # there would be no velocity.nc
        (["pairs/tracks-0000.nc", ALONE], 2, False),
        (["pairs/tracks-0000.nc", ONE_OF_SEVERAL], 1, False),
        (["pairs/tracks-0000.nc", ONE_OF_SEVERAL], 2, True),
        (["pairs/particles-0000.npz", "pairs/particles-0001.npz"], 3, True),  # a sequence's fields come at the end
        (["volume-0.h5", ONE_OF_SEVERAL], 1, False),
    ],
)
def test_a_pair_is_kept_where_its_field_has_the_name_that_it_would_have_now(tmp_path, files, pairs, stays):
    finish_one(tmp_path / "results", files)
    assert kept(tmp_path / "results", recording_of(tmp_path, pairs)) == ([0] if stays else [])


def test_frames_that_were_exchanged_are_found_where_size_and_time_are_equal(tmp_path):
    """Names exchanged on a disk whose clock is coarse; a read tells, where a pair's two files are alike."""
    images = [np.full((4, 4), k, np.uint16) for k in range(2)]
    for k, time in enumerate((7, 7)):
        (tmp_path / f"{k}.tif").write_bytes(b"image")
        os.utime(tmp_path / f"{k}.tif", ns=(time, time))
    frames = [SimpleNamespace(name=f"{k}.tif", path=tmp_path / f"{k}.tif") for k in range(2)]
    entries = [read_entry(frame_entry(frame), image) for frame, image in zip(frames, images, strict=True)]
    read = []

    def light(k):
        read.append(k)
        return images[k], ()

    recording = SimpleNamespace(pairs=((0, 1),), frames=frames, light=light)
    record = {"pair": 0, "frames": entries}
    assert changed_frame(recording, record) is None
    images.reverse()
    assert changed_frame(recording, record) == "0.tif is another image than the one that was measured"
    images.reverse()
    os.utime(tmp_path / "1.tif", ns=(8, 8))
    entries[1] = read_entry(frame_entry(frames[1]), images[1])
    read.clear()
    assert changed_frame(recording, record) is None
    assert read == []
    pages = [SimpleNamespace(name=f"run.tif {k}", path=tmp_path / "0.tif") for k in range(2)]
    recording.frames = pages  # of one file, which cannot be exchanged without a trace
    record["frames"] = [read_entry(frame_entry(page), image) for page, image in zip(pages, images, strict=True)]
    assert changed_frame(recording, record) is None
    assert read == []


@pytest.mark.parametrize("pairs", [1, 2])
def test_a_pair_that_was_set_aside_has_no_field_and_is_kept(tmp_path, pairs):
    finish_one(tmp_path / "results", [], "a frame is dark")
    assert kept(tmp_path / "results", recording_of(tmp_path, pairs)) == [0]


@pytest.mark.parametrize(("file", "pairs"), [(ALONE, 2), (ONE_OF_SEVERAL, 1)])
def test_a_pair_of_other_frames_is_not_forgotten_in_silence(tmp_path, file, pairs):
    finish_one(tmp_path / "results", [file])
    now = recording_of(tmp_path, pairs)
    now.frames[0].name = "another.tif"
    with pytest.raises(PlenoPIVError, match=r"pair 0 was 0\.tif and 1\.tif, is another\.tif"):
        kept(tmp_path / "results", now)
