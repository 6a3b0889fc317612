"""What tests of whole runs share."""

import importlib
import pkgutil

import plenopiv.run


def without_report(patch):
    """Spare drawing reports that the test does not read: half the time of a small run. ``patch`` is pytest's
    monkeypatch."""
    modules = [importlib.import_module(f"plenopiv.run.{m.name}") for m in pkgutil.iter_modules(plenopiv.run.__path__)]
    drawing = [module for module in modules if hasattr(module, "write_report")]
    assert drawing
    for module in drawing:
        patch.setattr(module, "write_report", lambda *given, **named: None)
        for name in ("light_field_stacks", "volume_stack"):
            patch.setattr(module, name, lambda *given, name=name: [] if name == "light_field_stacks" else None)
