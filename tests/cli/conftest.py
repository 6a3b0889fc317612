"""A drafted experiment on random images, and the one line of a command that fails."""

import json

import numpy as np
import pytest
import tifffile
from drafted_recording import COLUMNS, ROWS, SHEET

from plenopiv.cli import main


@pytest.fixture
def folder(tmp_path):
    """A folder of random images with the draft that init makes of it."""
    images = tmp_path / "run7"
    images.mkdir()
    rng = np.random.default_rng(2)
    for name in ("White_0.tif", "frame10.tif", "frame9.tif"):
        tifffile.imwrite(images / name, rng.integers(60, 900, (ROWS, COLUMNS)).astype(np.uint16))
    (tmp_path / "optics.json").write_text(json.dumps(SHEET))
    assert main(["init", str(images), str(tmp_path / "optics.json")]) == 0
    return images


@pytest.fixture
def one_line(capsys):
    """Run a command line that must fail, and return its one line."""

    def fail(*arguments):
        capsys.readouterr()
        assert main([str(a) for a in arguments]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("plenopiv: error: ")
        assert err.count("\n") == 1
        assert err.endswith("\n")
        return err.strip()

    return fail
