"""docs/troubleshooting.md: its messages are the program's, and every finding of a check is there."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
MESSAGES, FINDINGS = PAGE.split("## Findings of a check\n")


def first_column(text):
    return [word for row in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for word in re.findall(r"`([^`]+)`", row)]


def texts(tree):
    """Texts of a module; what is formatted into one is left out, texts side by side are one."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(part.value if isinstance(part, ast.Constant) else "\0" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.fixture(scope="module")
def trees():
    return {path: ast.parse(path.read_text()) for path in (ROOT / "src" / "plenopiv").rglob("*.py")}


def names_of_findings(trees):
    """What a ``Finding`` may be called: first arguments, and what the variables that stand there are set to."""
    for path, tree in trees.items():
        if path.parent.name != "checks":
            continue
        calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and ast.unparse(n.func) == "Finding"]
        for call in calls:
            if isinstance(call.args[0], ast.Constant):
                yield call.args[0].value, call
                continue
            for node in ast.walk(tree):
                if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == ast.unparse(call.args[0]):
                    values = [node.value] if isinstance(node.value, ast.Constant) else []
                    if isinstance(node.value, ast.IfExp):
                        values = [node.value.body, node.value.orelse]
                    yield from ((value.value, call) for value in values if isinstance(value, ast.Constant))


def test_messages_are_the_program_s(trees):
    said = [text for tree in trees.values() for text in texts(tree)]
    words = first_column(MESSAGES)
    assert len(words) > 30
    assert [word for word in words if not any(word in text for text in said)] == []


def test_every_finding_is_on_the_page_and_no_other(trees):
    names = {}
    for name, call in names_of_findings(trees):
        good = isinstance(call.args[1], ast.Constant) and call.args[1].value == "good"
        names[name] = names.get(name, True) and good
    never_bad = {name for name, good in names.items() if good}
    listed = set(first_column(FINDINGS))
    assert set(names) - never_bad == listed
