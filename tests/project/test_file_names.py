"""Names of scripts and test files: what is imported by its name alone must have that name for itself."""

from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]


def repeated(*folders: str, pattern: str = "*.py") -> set[str]:
    names = Counter(file.name for folder in folders for file in (ROOT / folder).rglob(pattern))
    return {name for name, times in names.items() if times > 1 and name != "conftest.py"}


def test_no_two_scripts_share_a_name():
    """Tests and scripts put these folders on the path: of two modules with one name the first imported serves both."""
    assert repeated("benchmarks", "campaigns", "paper", "tests") == set()


def test_no_two_test_files_share_a_name():
    """pytest imports a test file by its name alone."""
    assert repeated("tests", pattern="test_*.py") == set()
