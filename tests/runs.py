"""What tests of whole runs share."""

import importlib
import pkgutil
from pathlib import Path

import plenopiv.run


def without_report(patch):
    """Spare drawing reports that the test does not read: half the time of a small run. ``patch`` is pytest's
    monkeypatch."""
    modules = [importlib.import_module(f"plenopiv.run.{m.name}") for m in pkgutil.iter_modules(plenopiv.run.__path__)]
    drawn = {"light_field_stacks": [], "volume_stack": None}
    made = {name: lambda *given, instead=instead, **named: instead for name, instead in drawn.items()}
    made["write_report"] = lambda path, **named: Path(path).write_text("no report\n")
    for name, instead in made.items():
        drawing = [module for module in modules if hasattr(module, name)]
        assert drawing
        for module in drawing:
            patch.setattr(module, name, instead)
