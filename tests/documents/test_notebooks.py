"""The notebooks of docs/notebooks run from top to bottom, in a folder of their own, without Jupyter."""

import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.full

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.md"))


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_its_cells_run(name, tmp_path):
    cells = re.findall(r"^```\{code-cell\}[^\n]*\n(.*?)^```", (FOLDER / name).read_text(), re.DOTALL | re.MULTILINE)
    assert len(cells) >= 3
    (tmp_path / "cells.py").write_text("\n".join(cells))
    outside = os.environ | {"MPLBACKEND": "Agg"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run(
        [sys.executable, "cells.py"], cwd=tmp_path, env=outside, capture_output=True, text=True, timeout=900
    )
    print(f"{name}: {resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before:.0f} s\n{done.stdout}")
    assert done.returncode == 0, done.stderr[-3000:]
