"""Spots of a Python source that mutants change: a walk through its syntax tree."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from bisect import bisect_left
from dataclasses import dataclass
from itertools import pairwise

COMPARISONS = {
    ast.Lt: ("<", ("<=", ">")),
    ast.LtE: ("<=", ("<", ">=")),
    ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<=")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
}
SIGNS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+")}
SILENT = {"warn", "print", "cast", "progress", "TypeVar", "PlenoPIVError", "PlenoPIVWarning"}  # calls without a result
TYPES = {"tuple", "list", "dict", "set", "type", "frozenset"}
PAIRS = [("x", "y"), ("s", "t"), ("u", "v"), ("i", "j"), ("m", "n"), ("column", "row"), ("columns", "rows")]
PAIRS += [("ni", "nj"), ("wide", "high"), ("along", "across"), ("width", "height"), ("px", "py")]
OTHER = {a: b for one, two in PAIRS for a, b in ((one, two), (two, one))}
LARGE = 16  # integers above grow by half, as one more of them would hardly be noticed


Found = tuple[str, str, list["Edit"], tuple[int, int]]


@dataclass(frozen=True)
class Edit:
    """Characters ``start`` to ``end`` of a text become ``new``."""

    start: int
    end: int
    new: str


def other_name(name: str) -> str | None:
    """``half_y`` for ``half_x`` and the like; None of a name that belongs to no pair."""
    parts = name.split("_")
    for n, part in enumerate(parts):
        if part in OTHER:
            return "_".join([*parts[:n], OTHER[part], *parts[n + 1 :]])
        if match := re.fullmatch(r"([a-z]?)([xyij])(\d*)", part):
            before, letter, digits = match.groups()
            if letter in "xy" or digits:
                return "_".join([*parts[:n], before + OTHER[letter] + digits, *parts[n + 1 :]])
    return None


def _names(node: ast.AST) -> set[str]:
    names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    return names | {n.arg for n in ast.walk(node) if isinstance(n, ast.arg)}


def find(text: str) -> list[Found]:
    """Spots of a source: function, kind, the edits that one spot allows, and the lines of the function."""
    finder = _Finder(text)
    finder.visit(ast.parse(text))
    return finder.found


class _Finder(ast.NodeVisitor):
    def __init__(self, text: str):
        self.text, self.found = text, list[Found]()
        self.rows = text.splitlines(keepends=True)
        self.begins = [0]
        for row in self.rows:
            self.begins.append(self.begins[-1] + len(row))
        self.scope: list[str] = []
        self.known: list[set[str]] = [set()]
        self.lines: list[tuple[int, int]] = [(1, 1)]
        tree = ast.parse(text)
        self.attributes = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        self.symbols = [(self.begins[t.start[0] - 1] + t.start[1], t.string) for t in tokens if t.type == tokenize.OP]

    def place(self, line: int, column: int) -> int:
        """Number of a character; the syntax tree counts bytes of UTF-8."""
        row = self.rows[line - 1]
        return self.begins[line - 1] + (column if row.isascii() else len(row.encode()[:column].decode()))

    def span(self, node: ast.expr) -> tuple[int, int]:
        return self.place(node.lineno, node.col_offset), self.place(node.end_lineno, node.end_col_offset)

    def add(self, kind: str, *edits: Edit) -> None:
        self.found.append((".".join(self.scope) or "module", kind, list(edits), self.lines[-1]))

    def source(self, node: ast.expr) -> str:
        start, end = self.span(node)
        return self.text[start:end]

    def symbol(self, symbol: str, after: int) -> int:
        """Where the first such symbol from a place on is: brackets and comments may come before it."""
        first = bisect_left(self.symbols, (after, ""))
        return next(at for at, string in self.symbols[first:] if string == symbol)

    # What encloses

    def visit_Module(self, node: ast.Module) -> None:
        for statement in node.body:
            self.lines.append((statement.lineno, statement.end_lineno or statement.lineno))
            self.visit(statement)
            self.lines.pop()

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for default in [*node.args.defaults, *node.args.kw_defaults]:
            if default is not None:
                self.visit(default)
        self.scope.append(node.name)
        self.known.append(_names(node))
        self.lines.append((node.lineno, node.end_lineno or node.lineno))
        for statement in node.body:
            self.visit(statement)
        for held in (self.scope, self.known, self.lines):
            held.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self.scope.append(node.name)
        for statement in node.body:
            self.visit(statement)
        self.scope.pop()

    def visit_If(self, node: ast.If) -> None:
        if "TYPE_CHECKING" not in _names(node.test):
            self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        pass

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        pass

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name not in SILENT:
            self.generic_visit(node)

    # What can be wrong

    def visit_BinOp(self, node: ast.BinOp) -> None:
        sides = node.left, node.right
        strings = any(isinstance(s, ast.JoinedStr) or isinstance(getattr(s, "value", 0), str) for s in sides)
        if type(node.op) in SIGNS and not strings:
            old, new = SIGNS[type(node.op)]
            at = self.symbol(old, self.span(node.left)[1])
            self.add("sign", Edit(at, at + 1, new))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.USub):
            at = self.span(node)[0]
            self.add("sign", Edit(at, at + 1, "+"))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if type(node.op) in SIGNS:
            old, new = SIGNS[type(node.op)]
            at = self.symbol(old + "=", self.span(node.target)[1])
            self.add("sign", Edit(at, at + 1, new))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            return
        new: float
        if isinstance(value, int):
            new = {0: 1, 1: 0}.get(value, value + 1 if value <= LARGE else value * 3 // 2)
        else:
            new = value * 1.5 if value else 1.0
        self.add("constant", Edit(*self.span(node), repr(new)))

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, operator in zip([node.left, *node.comparators], node.ops, strict=False):
            if type(operator) in COMPARISONS:
                old, others = COMPARISONS[type(operator)]
                at = self.symbol(old, self.span(left)[1])
                self.add("comparison", *(Edit(at, at + len(old), new) for new in others))
        self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg == "axis" and isinstance(node.value, ast.Constant) and isinstance(node.value.value, int):
            self.add("axis order", self.other_axis(node.value))
        else:
            self.generic_visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        name = node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
        if name in TYPES or name[:1].isupper():
            return
        self.visit(node.value)
        index = node.slice
        if isinstance(index, ast.Tuple):
            pairs = [pair for pair in pairwise(index.elts) if self.source(pair[0]) != self.source(pair[1])]
            if pairs:
                self.add("axis order", self.exchanged(*min(pairs, key=lambda pair: not self.paired(*pair))))
            rest = [part for part in index.elts if not isinstance(part, ast.Constant)]
        elif isinstance(index, ast.Constant) and index.value in (0, 1, 2) and not isinstance(index.value, bool):
            self.add("axis order", self.other_axis(index))
            rest = []
        else:
            rest = [index]
        for part in rest:
            self.visit(part)

    def visit_Tuple(self, node: ast.Tuple) -> None:
        for one, two in pairwise(node.elts):
            if self.paired(one, two):
                self.add("axis order", self.exchanged(one, two))
                break
        self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> None:
        other = other_name(node.id)
        if isinstance(node.ctx, ast.Load) and other in self.known[-1]:
            self.add("axis order", Edit(*self.span(node), other))

    def visit_Attribute(self, node: ast.Attribute) -> None:
        end, other = self.span(node)[1], other_name(node.attr)
        if node.attr == "T":
            self.add("axis order", Edit(end - 2, end, ""))
        elif isinstance(node.ctx, ast.Load) and other in self.attributes:
            self.add("axis order", Edit(end - len(node.attr), end, other))
        self.visit(node.value)

    def other_axis(self, node: ast.Constant) -> Edit:
        return Edit(*self.span(node), "1" if node.value in (0, 2) else "0")

    def exchanged(self, one: ast.AST, two: ast.AST) -> Edit:
        (start, a), (b, end) = self.span(one), self.span(two)
        return Edit(start, end, self.text[b:end] + self.text[a:b] + self.text[start:a])

    def paired(self, one: ast.AST, two: ast.AST) -> bool:
        """Whether one is the other with x for y."""
        a, b = self.source(one), self.source(two)
        return a != b and re.sub(r"[A-Za-z_]\w*", lambda name: other_name(name[0]) or name[0], a) == b
