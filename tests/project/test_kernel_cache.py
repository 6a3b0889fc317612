"""Compiled code is kept by content, between processes and folders."""

import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numba
import pytest

import plenopiv
from plenopiv.errors import PlenoPIVWarning
from plenopiv.kernels import kernel, store

SOURCE = Path(plenopiv.__file__).parents[1]
CALLER = '''
"""Says what it compiles."""
import sys, time
from tiny.callee import doubled
from plenopiv.kernels import kernel
from plenopiv.kernels.numba_internals import event


class Compiled(event.Listener):
    names = []
    def on_start(self, started):
        self.names.append(started.data["dispatcher"].py_func.__name__)
        time.sleep(0.3)  # another process asks for it meanwhile
    def on_end(self, ended):
        pass


@kernel
def twice(x):
    """What it does."""
    return doubled(x)


if __name__ == "__main__":
    event.register("numba:compile", Compiled())
    print(twice(3.0), *Compiled.names)
'''
CALLEE = "from plenopiv.kernels import part\n\n\n@part\ndef doubled(x):\n    return x + x\n"


def started(folder, caller=CALLER, callee=CALLEE, cache=None, variable="XDG_CACHE_HOME"):
    """A process that calls a kernel of a small package written to ``folder``."""
    package = folder / "tiny"
    package.mkdir(parents=True, exist_ok=True)
    (package / "__init__.py").touch()
    (package / "caller.py").write_text(caller)
    (package / "callee.py").write_text(callee)
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    environment |= {variable: str(cache), "PYTHONPATH": os.pathsep.join([str(folder), str(SOURCE)])}
    command = [sys.executable, "-m", "tiny.caller"]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(process):
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    value, *compiled = out.split()
    return float(value), compiled, err


@pytest.mark.full
def test_what_is_compiled_again(tmp_path):
    cache = tmp_path / "cache"
    assert ended(started(tmp_path / "one", cache=cache)) == (6.0, ["twice", "doubled"], "")
    said = CALLER.replace("What it does.", "What it does, said otherwise.").replace("@kernel", "# a comment\n\n@kernel")
    assert ended(started(tmp_path / "two", said, cache=cache)) == (6.0, [], "")  # another clone
    edited = CALLEE.replace("x + x", "2.5 * x")  # a callee in another file
    assert ended(started(tmp_path / "one", said, edited, cache)) == (7.5, ["twice", "doubled"], "")


@pytest.mark.full
@pytest.mark.skipif(store.fcntl is None, reason="no locks on this system")
def test_two_processes_do_not_compile_the_same(tmp_path):
    both = [started(tmp_path / name, cache=tmp_path / "cache") for name in ("one", "two")]
    found = [ended(process) for process in both]
    assert [value for value, *_ in found] == [6.0, 6.0]
    assert sorted(name for _, compiled, _ in found for name in compiled) == ["doubled", "twice"]


@pytest.mark.full
def test_numbas_folder_has_precedence_and_damage_is_mended(tmp_path):
    cache = tmp_path / "numba"
    assert ended(started(tmp_path, cache=cache, variable="NUMBA_CACHE_DIR"))[1] == ["twice", "doubled"]
    files = list((cache / "plenopiv").iterdir())
    assert len(files) == 1  # of the kernel, its parts within it
    assert {path.suffix for path in files} == {store.ENDING}
    for path in files:
        path.write_bytes(path.read_bytes()[:-100])
    assert ended(started(tmp_path, cache=cache, variable="NUMBA_CACHE_DIR")) == (6.0, ["twice", "doubled"], "")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache of this process' own."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(store, "done_once", set())
    return tmp_path / "plenopiv"


def incremented():
    @kernel
    def increment(x):
        return x + 1

    return increment


def test_a_folder_that_cannot_be_written_is_told_once(folder):
    folder.write_text("a file is in its place")
    increment = incremented()
    with pytest.warns(PlenoPIVWarning, match="NUMBA_CACHE_DIR"):
        assert increment(1.0) == 2.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert increment(1) == 2


def test_what_does_not_compile_leaves_no_lock(folder):
    @kernel
    def impossible(x):
        return x.nothing_of_the_kind

    with pytest.raises(numba.TypingError):
        impossible(1.0)
    assert not list(folder.iterdir())


def test_files_that_are_not_used_go(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    long_ago = time.time() - 86400 * (store.KEPT_DAYS + 1)
    folder.mkdir()
    old, foreign = folder / f"old{store.ENDING}", folder / "notes.txt"
    former = tmp_path / "user" / "plenopiv" / "0123456789abcdef"
    former.mkdir(parents=True)
    for path in (old, foreign):
        path.touch()
    for path in (old, foreign, former):
        os.utime(path, (long_ago, long_ago))
    assert incremented()(1.0) == 2.0
    assert not old.exists()
    assert not former.exists()
    assert foreign.exists()
    assert len(list(folder.glob(f"*{store.ENDING}"))) == 1


def test_use_keeps_a_file(folder):
    assert incremented()(1.0) == 2.0
    (path,) = folder.iterdir()
    os.utime(path, (0, 0))
    again = incremented()
    assert again(1.0) == 2.0
    assert sum(again.stats.cache_hits.values()) == 1
    assert time.time() - path.stat().st_mtime < 3600


BITS = """
import hashlib
import numpy as np
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.chain import Chain
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.volume import VoxelGrid

camera = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077, 0.004), 0.308, Sensor(420, 380, 0.0055, 12, 60)
)
grid = VoxelGrid.covering((-0.75, 0.75), (-0.65, 0.65), (-1.6, 1.6), (0.017, 0.017, 0.077))
chain = Chain((camera,), grid, correlation=CorrelationSettings(windows=((32, 32, 16),)))
rng = np.random.default_rng(0)
images = [60 + rng.poisson(30.0, (380, 420)) + 400 * (rng.random((380, 420)) > 0.98) for _ in range(2)]
volumes = [chain.reconstruct([image.astype(np.float32)]).volume for image in images]
field = chain.displacement(*volumes)
print(hashlib.sha256(field.displacement.tobytes() + field.std.tobytes() + volumes[0].values.tobytes()).hexdigest())
"""


@pytest.mark.full
def test_the_same_bits_compiled_and_loaded(tmp_path):
    here = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": ""}
    said = [
        subprocess.run([sys.executable, "-c", BITS], env=here, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert any(tmp_path.rglob("*.kernel"))
    assert said[0] == said[1]
