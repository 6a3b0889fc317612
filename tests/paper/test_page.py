"""The tables of docs/paper.md, and the jet's of docs/uncertainty.md, are those of the recorded numbers."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "paper"))

import page

pytestmark = pytest.mark.full


@pytest.mark.parametrize(("of", "name"), [(of, name) for of, tables in page.PAGES.items() for name in tables])
def test_a_table_says_what_was_recorded(of, name):
    text = (page.DOCS / of).read_text()
    assert page.fill(text, name, page.PAGES[of][name]()) == text
