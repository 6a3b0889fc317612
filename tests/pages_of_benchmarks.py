"""Pages that scripts write, without the line on tables that an earlier program made (benchmarks/fresh.py)."""

import re


def as_written(page):
    """The text of a page as its own script wrote it."""
    return re.sub(r"<!-- fresh: begin -->.*?<!-- fresh: end -->\n\n", "", page.read_text(), flags=re.DOTALL)
