"""Every command of docs/tutorial.md, as written, in a clone whose environment is this one (no network)."""

import os
import re
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.full

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tutorial.md").read_text()
COMMANDS = re.findall(r"^```sh\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)

SCORE = r"^\d+ vectors, RMS error along .*$"
DEMO = r"^Solid-body rotation about y.*?^Report"


def shown(pattern, text):
    """The numbers of what a command printed."""
    found = re.search(pattern, text, re.MULTILINE | re.DOTALL if "Report" in pattern else re.MULTILINE)
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", found[0])]


def clone(place):
    """The repository as it is on disk, with a .venv that has this environment's packages, so that make fetches none."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_bytes((ROOT / name).read_bytes())
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", place / ".venv"], check=True)
    python = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = f"{place / 'src'}\n{sysconfig.get_paths()['purelib']}\n"
    (place / ".venv" / "lib" / python / "site-packages" / "borrowed.pth").write_text(packages)
    command = place / ".venv" / "bin" / "plenopiv"
    command.write_text(
        f"#!{place / '.venv' / 'bin' / 'python'}\nimport sys\nfrom plenopiv.cli import main\n\nsys.exit(main())\n"
    )
    command.chmod(0o755)
    (place / ".venv" / ".ready").touch()


def test_the_tutorial_as_written(tmp_path):
    place = tmp_path / "plenopiv"
    place.mkdir()
    clone(place)
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "PYTHON"))}
    script = "set -e\n" + "".join(f"echo '##{k}'\n{block}" for k, block in enumerate(COMMANDS))
    begun = time.monotonic()
    done = subprocess.run(["bash", "-c", script], cwd=place, env=kept, capture_output=True, text=True, timeout=1500)
    print(f"{time.monotonic() - begun:.0f} s")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    said = re.split(r"^##\d+\n", done.stdout, flags=re.MULTILINE)[1:]
    assert len(said) == len(COMMANDS)
    check = next(out for out, block in zip(said, COMMANDS, strict=True) if "plenopiv check" in block)
    assert "run7/experiment.toml: good" in check  # as the page says
    assert not re.search(r"^(warning|unusable)", check, re.MULTILINE)
    assert shown(SCORE, done.stdout) == pytest.approx(shown(SCORE, PAGE), abs=0.005)
    assert shown(DEMO, done.stdout) == pytest.approx(shown(DEMO, PAGE), abs=0.005)
