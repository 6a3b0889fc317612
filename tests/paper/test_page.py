"""The tables of docs/paper.md are those of the recorded numbers."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "paper"))

import page

pytestmark = pytest.mark.full


@pytest.mark.parametrize("name", page.TABLES)
def test_a_table_says_what_was_recorded(name):
    text = page.PAGE.read_text()
    assert page.fill(text, name, page.TABLES[name]()) == text
