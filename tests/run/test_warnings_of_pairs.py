"""What is warned of while a frame or a field is made stays with it, whether it is found, lost or set aside."""

import warnings
from types import SimpleNamespace

import pytest

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.run.frame import LostFrame, taken_or_lost
from plenopiv.run.pair import PairRecord
from plenopiv.run.track_frame import TrackedFrame


def warn(words):
    warnings.warn(words, PlenoPIVWarning, stacklevel=2)


def fail():
    warn("noisy")
    raise PlenoPIVError("no particles")


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "frame.tif"
    path.write_bytes(b"counts")
    return SimpleNamespace(frames=[SimpleNamespace(path=path, name=path.name, page=0, dataset=None)], damaged={})


def test_warnings_of_a_field_are_kept():
    record = PairRecord(0, [])
    with record.measuring(only=False):
        warn("large displacements")
        warn("large displacements")
    assert record.field_warnings == ["large displacements"]
    assert record.set_aside is None


def test_warnings_of_a_pair_that_is_set_aside_are_kept():
    record = PairRecord(0, [])
    with record.measuring(only=False):
        fail()
    assert record.set_aside == "no particles"
    assert record.field_warnings == ["noisy"]


def test_the_only_pair_is_not_set_aside():
    record = PairRecord(0, [])
    with pytest.raises(PlenoPIVError, match="no particles"), record.measuring(only=True):
        fail()
    assert record.set_aside is None


def test_warnings_of_a_frame_are_kept(recording):
    def take():
        warn("overexposed")
        return TrackedFrame(None, None)

    assert taken_or_lost(recording, 0, take).warned == ("overexposed",)


def test_warnings_of_a_lost_frame_are_kept(recording):
    lost = taken_or_lost(recording, 0, fail)
    assert isinstance(lost, LostFrame)
    assert (lost.reason, lost.warned) == ("no particles", ("noisy",))


def test_a_frame_whose_file_is_gone_ends_the_run(recording):
    def take():
        recording.frames[0].path.unlink()
        fail()

    with pytest.raises(PlenoPIVError, match=r"frame\.tif: is gone since the run began"):
        taken_or_lost(recording, 0, take)
