"""python -m plenopiv is the command line."""

import subprocess
import sys


def test_the_same_commands_and_exit_codes():
    told = subprocess.run([sys.executable, "-m", "plenopiv", "run", "none.toml"], capture_output=True, text=True)
    assert told.returncode == 2
    assert "none.toml: no such file" in told.stderr
