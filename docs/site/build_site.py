"""The documents as a site: ``make docs`` runs this, and build/site/html/index.html is its first page.

    python docs/site/build_site.py [--no-gallery] [--no-notebooks]

The pages of docs/ are copied to build/site/source, where links to files outside of docs/ lead to copies, and where the
pages that the program writes itself are added: commands, types of keys, modules. Sections of docs/index.md are the
navigation. Nothing is fetched from a network.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import make_gallery
from reference_pages import commands_page, key_types_page, module_pages

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SITE = ROOT / "build" / "site"
SOURCE = SITE / "source"
BESIDE = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md", "README.md": "readme.md"}
WRITTEN = {"Reference": ["commands", "key-types", "modules/index"]}  # by the program, for a section of index.md
APART = {"Decisions, with their reasons": "decisions/index"}  # too many for the sidebar: a page of their own
LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")


def write(path: Path, text: str) -> None:
    """Write where something changed: Sphinx reads new files alone."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


def copied(original: Path, at: str) -> str:
    """The text of a page that will be at ``at`` in the site: its links lead to pages and copies of files there."""
    up = "../" * at.count("/")

    def led(match: re.Match[str]) -> str:
        target, anchor = match[1], match[2] or ""
        path = (original.parent / target).resolve()
        if path.is_relative_to(DOCS):
            return f"{up}{path.relative_to(DOCS).as_posix()}{anchor}"
        inside = path.relative_to(ROOT).as_posix()
        if inside in BESIDE:
            return f"{up}{BESIDE[inside]}{anchor}"
        if path.is_dir() or not inside.endswith((".md", ".py", ".toml", ".txt", ".json", ".cff", "LICENSE")):
            inside = next(name for name in (f"{inside}/README.md", "README.md") if (ROOT / name).exists())
            return f"{up}{BESIDE.get(inside, inside)}"
        place = f"files/{inside}.txt"
        write(SOURCE / place, path.read_text())
        return f"{up}{place}"

    return LINK.sub(led, original.read_text())


def navigation(index: str) -> dict[str, str]:
    """``index.md`` with a hidden table of contents for each of its sections, as their links are; long ones apart."""
    texts = {}
    parts = re.split(r"^## (.+)\n", index, flags=re.MULTILINE)
    for k in range(1, len(parts), 2):
        pages = re.findall(r"^(?:- |\d+\. )\[[^\]]+\]\(([\w/-]+)\.md\)", parts[k + 1], re.MULTILINE)
        pages += WRITTEN.get(parts[k].strip(), [])
        if parts[k] in APART:
            texts[f"{APART[parts[k]]}.md"] = f"# {parts[k]}\n\n" + toctree([f"/{page}" for page in pages])
            pages = [APART[parts[k]]]
        if pages:
            parts[k + 1] += "\n" + toctree(pages, "hidden:", f"caption: {parts[k]}")
    texts["index.md"] = parts[0] + "".join(f"## {parts[k]}\n{parts[k + 1]}" for k in range(1, len(parts), 2))
    return texts


def toctree(pages: list[str], *options: str) -> str:
    """MyST's directive for a table of contents."""
    return "\n".join(["```{toctree}", *(f":{option}" for option in options), "", *pages, "```", "", ""])


def with_reports(page: str) -> str:
    """The gallery's page with the reports that there are, each in a frame of its own and as a page."""
    shown = SOURCE / "_extra" / "reports"
    shown.mkdir(parents=True, exist_ok=True)

    def frame(match: re.Match[str]) -> str:
        name = match[1]
        report = make_gallery.GALLERY / name / "report.html"
        if not report.exists():
            return "*Not made in this build.*"
        shutil.copy(report, shown / f"{name}.html")
        facts = json.loads((report.parent / "facts.json").read_text())
        return (
            f"{facts['vectors']} vectors, {100 * facts['replaced_share']:.1f} % of them replaced. "
            f'<a href="reports/{name}.html">The report as a page</a>\n\n'
            f'<iframe class="report" src="reports/{name}.html" title="report: {name}" loading="lazy"></iframe>'
        )

    return re.sub(r"<!-- report: ([\w-]+) -->", frame, page)


def lay_out() -> None:
    """All pages in build/site/source, and none of an earlier build that is no more."""
    pages = {f"{path.relative_to(DOCS).as_posix()}": path for path in DOCS.rglob("*.md")}
    pages |= {name: ROOT / path for path, name in BESIDE.items()}
    texts = {at: copied(path, at) for at, path in pages.items()}
    texts |= navigation(texts["index.md"])
    texts["gallery.md"] = with_reports(texts["gallery.md"])
    texts["readme.md"] = "---\norphan: true\n---\n" + texts["readme.md"]
    texts |= {"commands.md": commands_page(), "key-types.md": key_types_page()} | module_pages()
    for at, text in texts.items():
        write(SOURCE / at, text)
    for old in SOURCE.rglob("*.md"):
        if old.relative_to(SOURCE).as_posix() not in texts:
            old.unlink()
    shutil.copytree(DOCS / "images", SOURCE / "images", dirs_exist_ok=True)
    (SOURCE / "_extra").mkdir(exist_ok=True)
    (SOURCE / "_static").mkdir(exist_ok=True)
    shutil.copy(DOCS / "site" / "site.css", SOURCE / "_static")


def main() -> int:
    """Lay the pages out and run Sphinx, for which a warning is an error."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--no-gallery", action="store_true", help="leave the reports of the gallery out")
    words.add_argument("--no-notebooks", action="store_true", help="do not execute the notebooks")
    chosen = words.parse_args()
    if not chosen.no_gallery:
        make_gallery.main()
    lay_out()
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-j", "auto", "-c", str(DOCS / "site")]
    command += ["-d", str(SITE / "doctrees"), str(SOURCE), str(SITE / "html")]
    if chosen.no_notebooks:
        command += ["-D", "nb_execution_mode=off"]
    done = subprocess.run(command, env=os.environ | {"PLENOPIV_ROOT": str(ROOT)}).returncode
    if done == 0:
        print(SITE / "html" / "index.html")
    return done


if __name__ == "__main__":
    sys.exit(main())
