"""What a task does on a worker before it computes: threads, folder, versions, the job's file."""

import hashlib
import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.run.inputs import computing_versions
from plenopiv.run.pair import Job

on_worker = pytest.importorskip("plenopiv.run.on_worker")


@pytest.fixture
def handle(tmp_path):
    content = pickle.dumps(Job(None, None, None, tmp_path / "work", "a test"))
    (tmp_path / "job").write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    made = on_worker.Handle(tmp_path / "job", digest, tmp_path, tuple(computing_versions().items()), 2)
    yield made
    on_worker.forget(made)


def test_threads_and_folder_are_those_of_the_run(handle):
    before = numba.get_num_threads(), Path.cwd()
    with on_worker._at_work(handle) as job:
        assert numba.get_num_threads() == 2
        assert Path.cwd() == handle.folder
        assert job.source == "a test"
    assert (numba.get_num_threads(), Path.cwd()) == before
    with on_worker._at_work(replace(handle, threads=10_000)):
        assert numba.get_num_threads() == numba.config.NUMBA_NUM_THREADS


def test_a_job_is_read_once(handle):
    with on_worker._at_work(handle) as job:
        pass
    handle.job.unlink()
    with on_worker._at_work(handle) as again:
        assert again is job


def test_nothing_is_written_once_the_run_has_ended(handle):
    with on_worker._at_work(handle) as job:
        assert job._path("pairs/a.nc").parent.is_dir()
        handle.job.unlink()
        with pytest.raises(PlenoPIVError, match="the run that this pair belongs to has ended"):
            job._path("pairs/b.nc")


@pytest.mark.parametrize(("there", "words"), [(False, "nowhere: the worker on .* cannot read it"), (True, "is gone")])
def test_a_worker_that_does_not_see_the_recording(handle, tmp_path, monkeypatch, there, words):
    source = SimpleNamespace(path=(tmp_path if there else tmp_path / "nowhere") / "a.tif")
    content = pickle.dumps(Job(None, SimpleNamespace(frames=[source]), None, tmp_path / "work", "a test"))
    handle.job.write_bytes(content)

    def gone(self, number, progress):
        raise PlenoPIVError(f"{source.path}: is gone since the run began")

    monkeypatch.setattr(Job, "frame", gone)
    with pytest.raises(PlenoPIVError, match=words):
        on_worker.frame(replace(handle, digest=hashlib.sha256(content).hexdigest()), 0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"versions": (("numba", "0.1"),)}, "has numba .*, this run 0.1, which may change results"),
        ({"digest": "0"}, "is damaged, or another run's"),
        ({"job": Path("/nowhere/job")}, "cannot read it .* put recording and output.directory where all workers"),
        ({"folder": Path("/nowhere")}, "cannot read it .* put recording and output.directory where all workers"),
    ],
)
def test_what_a_worker_refuses(handle, change, words):
    with pytest.raises(PlenoPIVError, match=words), on_worker._at_work(replace(handle, **change)):
        pass
