"""Which device computes: what is asked for and is not there, what is kept of it, and nothing without it."""

import importlib.util
import json
import subprocess
import sys

import pytest
import tomli_w

from plenopiv.cli import main
from plenopiv.device import backend
from plenopiv.device.backend import CPU, device_of
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment

jax = pytest.importorskip("jax")  # a development requirement

WITHOUT_GPU = pytest.mark.skipif(jax.default_backend() == "gpu", reason="there is a graphics processor")
TABLES = {
    "camera": {
        "kind": "plenoptic",
        "main_lens": {"focal_length_mm": 50.0, "aperture_mm": 25.0, "magnification": -1.0},
        "microlens_array": {
            "lattice": "hexagonal",
            "pitch_mm": 0.077,
            "focal_length_mm": 0.308,
            "rotation_deg": 0.2,
            "offset_mm": [0.01, -0.02],
        },
        "sensor": {"columns": 420, "rows": 380, "pixel_pitch_mm": 0.0055, "bit_depth": 12},
    },
    "recording": {"frames": ["a.tif", "b.tif"], "dt_s": 0.0005, "orientation": "upright"},
    "volume": {
        "x_mm": [-0.7, 0.7],
        "y_mm": [-0.6, 0.6],
        "z_mm": [-1.0, 1.0],
        "voxel_mm": [0.0385, 0.0385, 0.077],
    },
    "correlation": {"windows": [[24, 24, 12]]},
}


def test_this_processor_is_what_computes_without_a_word():
    assert Experiment.from_dict(TABLES).compute.device == "cpu"
    assert device_of("cpu") is CPU
    assert (CPU.stated, CPU.text, CPU.versions) == ("cpu", "this processor", ())


@WITHOUT_GPU
def test_a_graphics_processor_that_is_not_there_is_refused_in_a_line():
    with pytest.raises(PlenoPIVError) as told:
        device_of("gpu")
    assert "\n" not in str(told.value)
    for words in ('compute.device = "gpu"', "finds no such device", 'pip install "plenopiv[gpu]"', "cpu"):
        assert words in str(told.value)
    assert device_of("auto") is CPU


@pytest.mark.parametrize("asked", ["gpu", "jax-cpu"])
def test_without_jax_it_says_how_to_get_it(monkeypatch, asked):
    usual = importlib.util.find_spec
    monkeypatch.setattr(backend, "find_spec", lambda name, *rest: None if name == "jax" else usual(name, *rest))
    with pytest.raises(PlenoPIVError, match=r'needs JAX: pip install "plenopiv\[gpu\]"'):
        device_of(asked)
    assert device_of("auto") is CPU


def test_what_is_stated_of_a_device():
    found = device_of("jax-cpu", 3.0)
    assert (found.kind, found.memory) == ("jax-cpu", 3e9)
    assert found.stated == "jax-cpu: this processor"
    assert dict(found.versions)["jax"] == jax.__version__
    assert "3.00 GB" in found.text
    with found.in_use():
        assert jax.numpy.zeros(1).device.platform == "cpu"


def test_a_graphics_processor_lends_what_it_has(monkeypatch):
    class Card:
        device_kind = "Card"

        def memory_stats(self):
            return {"bytes_limit": 8e9}

    monkeypatch.setattr(backend, "_found", lambda platform: Card())
    assert device_of("gpu").memory == 8e9
    assert device_of("auto").stated == "gpu: Card"
    assert device_of("gpu", 5.0).memory == 5e9
    with pytest.raises(PlenoPIVError, match=r"device_memory_gb = 9.*Card lends 8\.00 GB"):
        device_of("gpu", 9.0)


def test_keys_of_the_experiment_file():
    given = Experiment.from_dict(TABLES | {"compute": {"device": "auto", "device_memory_gb": 6.0}})
    assert given.compute.device == "auto"
    assert 'device = "auto"' in given.dump_toml()
    assert given.on_device("cpu").compute.device_memory_gb == 6.0
    assert given.on_device(None) is given
    for wrong in ({"device": "cuda"}, {"device_memory_gb": 0.0}, {"devise": "cpu"}):
        with pytest.raises(PlenoPIVError, match="compute"):
            Experiment.from_dict(TABLES | {"compute": wrong})


@WITHOUT_GPU
@pytest.mark.parametrize("command", ["run", "preview"])
def test_the_command_line_says_it_in_a_line(tmp_path, capsys, command):
    (tmp_path / "experiment.toml").write_text(tomli_w.dumps(TABLES))
    for kind, words in (("gpu", "finds no such device"), ("cuda", "--device cuda: give cpu, gpu or auto")):
        assert main([command, str(tmp_path / "experiment.toml"), "--device", kind]) == 2
        told = capsys.readouterr().err.strip()
        assert words in told
        assert "\n" not in told
    assert [path.name for path in tmp_path.iterdir()] == ["experiment.toml"]


def test_nothing_imports_jax_where_this_processor_computes():
    """An import of it would raise: there is none on most machines."""
    program = """
import sys
class Blocker:
    def find_spec(self, name, *rest):
        if name.partition(".")[0] in ("jax", "jaxlib"):
            raise ImportError(name)
sys.meta_path.insert(0, Blocker())
import plenopiv, plenopiv.chain, plenopiv.run.series, plenopiv.run.correlate, plenopiv.run.on_worker
from plenopiv.cli import main
from plenopiv.device.backend import device_of
assert device_of("cpu").kind == "cpu"
main(["run", "--help"])
print("jax" in sys.modules)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-1] == "False"
    assert "--device" in ended.stdout


def test_a_pickled_chain_finds_its_device(tmp_path):
    """As a worker gets it: what JAX is told is told again."""
    import pickle

    found = pickle.loads(pickle.dumps(device_of("jax-cpu")))
    with found.in_use():
        assert json.dumps(found.stated)
