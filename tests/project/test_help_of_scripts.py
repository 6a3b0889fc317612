"""Scripts of benchmarks, campaigns and the paper explain themselves."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = [
    file
    for folder in ("benchmarks", "campaigns", "paper", "examples")
    for file in sorted((ROOT / folder).rglob("*.py"))
    if all(part in file.read_text() for part in ("ArgumentParser(", "__main__"))
]


@pytest.mark.full
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda file: file.stem)
def test_help_teaches(script):
    """Also where the names of cases hold a per cent sign, which argparse would take for a format."""
    shown = subprocess.run([sys.executable, script, "--help"], capture_output=True, text=True, check=False)
    assert shown.returncode == 0, shown.stderr[-300:]
    assert "usage:" in shown.stdout
