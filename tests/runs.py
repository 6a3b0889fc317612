"""What tests of whole runs share."""

import importlib
import os
import pickle
import pkgutil
import tempfile
from pathlib import Path

import plenopiv.run

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


def made_once(factory, name, make):
    """What ``make(folder)`` returns, made by one of pytest's workers while the others wait for it. It must pickle.

    ``factory``: pytest's tmp_path_factory; ``name``: of the folder, one in all tests.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ or fcntl is None:
        return make(factory.mktemp(name))
    shared = factory.getbasetemp().parent
    kept = shared / f"{name}.pickle"
    with (shared / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            kept.write_bytes(pickle.dumps(make(Path(tempfile.mkdtemp(prefix=name, dir=shared)))))
    return pickle.loads(kept.read_bytes())


def without_report(patch):
    """Spare drawing reports that the test does not read: half the time of a small run. ``patch`` is pytest's
    monkeypatch."""
    modules = [importlib.import_module(f"plenopiv.run.{m.name}") for m in pkgutil.iter_modules(plenopiv.run.__path__)]
    drawn = {"light_field_stacks": [], "volume_stack": None}
    made = {name: lambda *given, instead=instead, **named: instead for name, instead in drawn.items()}
    made["write_report"] = lambda path, **named: Path(path).write_text(f"no report, of {named}\n")
    for name, instead in made.items():
        drawing = [module for module in modules if hasattr(module, name)]
        assert drawing
        for module in drawing:
            patch.setattr(module, name, instead)
