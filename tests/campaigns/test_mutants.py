"""Which spots of a source mutants change, and that they change nothing else."""

import ast
from pathlib import Path

import pytest
from mutants import KINDS, applied, changed_line, function_source, spots
from spot_finder import other_name

SOURCE = '''
"""A docstring with - 1 < 2."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    LIMIT = 3

SIZE: tuple[int, int] = (4, 0)
é = 2.0 - 0.5


def area(x, y, data, half: float = 0.25):
    """Not here: 1 + 1."""
    total = (x) - (  # a comment with -
        -y
    )
    total += data[0, 1] * 20
    if not data.any():
        raise ValueError(f"{1 + 1}: " + "none" * 2)
    return data.sum(axis=0).T, total <= half


class Box:
    width: int = 5

    def limits(self):
        lo, hi = (self.x_mm, self.y_mm)
        return lo < 1.5 < hi, self.y_mm[1:]
'''


def found(kind):
    """(function, changed text) of every spot of a kind."""
    return [(s.function, changed_line(SOURCE, s.edit)[2]) for s in spots(SOURCE) if s.kind == kind]


def test_signs():
    assert found("sign") == [
        ("module", "é = 2.0 + 0.5"),
        ("area", "total = (x) + (  # a comment with -"),
        ("area", "+y"),
        ("area", "total -= data[0, 1] * 20"),
    ]


def test_constants():
    assert found("constant") == [
        ("module", "SIZE: tuple[int, int] = (5, 0)"),
        ("module", "SIZE: tuple[int, int] = (4, 1)"),
        ("module", "é = 3.0 - 0.5"),
        ("module", "é = 2.0 - 0.75"),
        ("module", "def area(x, y, data, half: float = 0.375):"),
        ("area", "total += data[0, 1] * 30"),
        ("Box", "width: int = 6"),
        ("Box.limits", "return lo < 2.25 < hi, self.y_mm[1:]"),
        ("Box.limits", "return lo < 1.5 < hi, self.y_mm[0:]"),
    ]


def test_comparisons():
    changed = found("comparison")
    assert [function for function, _ in changed] == ["area", "Box.limits", "Box.limits"]
    assert changed[0][1].split("total ")[1] in ("< half", ">= half")
    assert changed[1][1].startswith(("return lo <= 1.5 < hi", "return lo > 1.5 < hi"))


def test_axis_orders():
    assert found("axis order") == [
        ("area", "total = (y) - (  # a comment with -"),
        ("area", "-x"),
        ("area", "total += data[1, 0] * 20"),
        ("area", "return data.sum(axis=1).T, total <= half"),
        ("area", "return data.sum(axis=0), total <= half"),
        ("Box.limits", "lo, hi = (self.y_mm, self.x_mm)"),
        ("Box.limits", "lo, hi = (self.y_mm, self.y_mm)"),
        ("Box.limits", "lo, hi = (self.x_mm, self.x_mm)"),
        ("Box.limits", "return lo < 1.5 < hi, self.x_mm[1:]"),
    ]


@pytest.mark.parametrize(
    ("name", "other"),
    [("half_x", "half_y"), ("ny", "nx"), ("x1", "y1"), ("i0", "j0"), ("s_mm", "t_mm"), ("at", None), ("z", None)],
)
def test_names_that_come_in_pairs(name, other):
    assert other_name(name) == other


def test_a_name_outlives_changes_elsewhere():
    moved = SOURCE.replace("é = 2.0 - 0.5", "é = 2.0 - 0.5\n\n\ndef before(a):\n    return a - 1 < 3\n")

    def of_area(text):
        return [(s.kind, s.number, function_source(text, s)) for s in spots(text) if s.function == "area"]

    assert of_area(SOURCE) == of_area(moved)
    assert of_area(SOURCE) != of_area(SOURCE.replace("data.any()", "data.all()"))


def test_mutants_of_the_library_are_python_and_differ():
    """Every ninth spot of a few modules: another program, which differs in one line or in a pair of exchanged ones."""
    package = Path(__file__).parents[2] / "src" / "plenopiv"
    for path in (package / "optics.py", package / "lattice.py", package / "displacement" / "uncertainty.py"):
        text = path.read_text()
        tree = ast.dump(ast.parse(text))
        every = spots(text)
        assert {s.kind for s in every} <= set(KINDS)
        assert len({(s.function, s.kind, s.number) for s in every}) == len(every)
        for spot in every[::9]:
            changed = applied(text, spot.edit)
            assert ast.dump(ast.parse(changed)) != tree
            assert changed.count("\n") == text.count("\n")
            lines = [n for n, (a, b) in enumerate(zip(text.split("\n"), changed.split("\n"), strict=True), 1) if a != b]
            assert lines[-1] - lines[0] <= spot.edit.new.count("\n")
            assert spot.function == "module" or spot.lines[0] <= lines[0] <= spot.lines[1]
