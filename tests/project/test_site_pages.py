"""Pages of docs/ and what the site makes of them: navigation, anchors."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md")])
INDEX = (DOCS / "index.md").read_text()


def without_code(text):
    return re.sub(r"^(`{3,}).*?^\1", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(path):
    """Of the headings of a page, as GitHub and MyST name them; of equal ones the later have a number."""
    found = {}
    for heading in re.findall(r"^#{1,6} (.+)$", without_code(path.read_text()), re.MULTILINE):
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        slug = re.sub(r"[^\w\- ]", "", text.lower()).strip().replace(" ", "-")
        found[slug] = found.get(slug, -1) + 1
    return {f"{slug}-{k}" if k else slug for slug, times in found.items() for k in range(times + 1)}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_anchors_are_headings(page):
    for target, anchor in re.findall(r"\]\(([^)#\s:]*)#([^)\s]+)\)", without_code(page.read_text())):
        to = (page.parent / target) if target else page
        assert anchor in anchors(to), f"{page.name}: {target}#{anchor}"


def test_every_page_is_in_the_index_which_is_the_navigation():
    listed = set(re.findall(r"^(?:- |\d+\. )\[[^\]]+\]\(([\w/-]+\.md)\)", INDEX, re.MULTILINE))
    assert listed == {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")} - {"index.md"}


def test_the_index_has_the_sections_of_diataxis():
    sections = re.findall(r"^## (.+)$", INDEX, re.MULTILINE)
    assert sections[:1] == ["Tutorial"]
    assert {"How-to guides", "Explanation", "Reference"} <= set(sections)
