"""Recorded tables say what made them, and pages which of theirs an earlier program made."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))

import fresh  # noqa: E402


def recorded_files():
    """Result files of the repository that a table may be made of."""
    found = [*(ROOT / "benchmarks").rglob("*.json"), *(ROOT / "paper" / "results").glob("*.json")]
    return {str(path.relative_to(ROOT)) for path in found} - {"benchmarks/made.json"}


def test_every_recorded_file_is_in_the_list_and_nothing_else():
    listed = {table.file for table in fresh.tables()}
    assert recorded_files() <= listed
    for table in fresh.tables():
        assert (ROOT / table.file.partition("#")[0]).is_file(), table.file
        assert table.content(), table.file


@pytest.mark.parametrize("table", fresh.tables(), ids=lambda table: table.name)
def test_an_entry_names_what_there_is(table):
    assert (ROOT / table.page).is_file()
    assert set(table.stages) <= set(fresh.DECISIONS)
    for command in table.commands:
        assert (ROOT / command.split()[0]).is_file(), command


def test_decisions_are_ones_that_there_are():
    numbers = {int(path.name[:4]) for path in (ROOT / "docs" / "decisions").glob("0*.md")}
    assert set(fresh.DECISIONS.values()) <= numbers


def test_pages_say_which_of_their_tables_are_stale():
    """Fails where a default, a decision or a table has changed: python benchmarks/fresh.py --pages, or --again."""
    for path, text in fresh.pages().items():
        assert path.read_text(encoding="utf-8") == text, f"{path.relative_to(ROOT)}: python benchmarks/fresh.py --pages"


def test_a_changed_default_decision_or_content_makes_a_table_stale(monkeypatch):
    table = next(table for table in fresh.tables() if table.name == "accuracy/ensemble")
    made = {table.file: {"content": table.content(), "made_with": json.loads(json.dumps(table.made_with_today()))}}
    assert table.why_stale(made) == ""
    assert table.why_stale({}) != ""
    assert table.why_stale({table.file: made[table.file] | {"content": "other"}}) == "not as it was recorded"

    monkeypatch.setitem(fresh.DECISIONS, "correlation", 99)
    assert table.why_stale(made).startswith("correlation.decision ")
    assert table.why_stale(made).endswith("-> 99")
    assert replace(table, stages=["reconstruction"]).why_stale(made) == ""
    settings = fresh.settings_today()
    settings["reconstruction"]["iterations"] += 1
    monkeypatch.setattr(fresh, "settings_today", lambda: settings)
    assert "reconstruction.iterations 5 -> 6" in table.why_stale(made)


def test_a_setting_that_is_new_makes_none_stale(monkeypatch):
    """What it changes by default is a decision, which has a number."""
    table = next(table for table in fresh.tables() if table.name == "accuracy/ensemble")
    made = {table.file: {"content": table.content(), "made_with": json.loads(json.dumps(table.made_with_today()))}}
    settings = fresh.settings_today()
    settings["reconstruction"]["brand_new"] = 1
    monkeypatch.setattr(fresh, "settings_today", lambda: settings)
    assert table.why_stale(made) == ""
    del made[table.file]["made_with"]["correlation"]
    assert table.why_stale(made).startswith("correlation.decision None -> ")


def test_a_page_has_a_line_while_one_of_its_tables_is_stale(monkeypatch):
    text = "# Title\n\nFirst words.\n"
    table = fresh.tables()[0]
    marked = fresh._marked(text, [table])
    assert table.name in marked
    assert marked.startswith("# Title\n\n<!-- fresh: begin -->")
    assert fresh._marked(marked, [table]) == marked
    assert fresh._marked(marked, []) == text


def test_a_case_has_a_stamp_of_what_made_it(monkeypatch):
    file = ROOT / "benchmarks" / "tracking" / "sequence.json"
    before = fresh.stamp(file)
    assert fresh.stamp(file) == before != fresh.stamp(file.with_name("full_size.json"))
    monkeypatch.setitem(fresh.DECISIONS, "optics", 99)
    assert fresh.stamp(file) == before
    monkeypatch.setitem(fresh.DECISIONS, "smoothing", 99)
    assert fresh.stamp(file) != before


def test_only_cases_of_an_earlier_program_are_made(monkeypatch, tmp_path):
    """And ended after the first of two, it goes on with the second."""
    sys.path.append(str(ROOT / "benchmarks" / "tracking"))
    import recorded

    path, cases, made = tmp_path / "a.json", {"one": {"n": 1}, "two": {"n": 2}, "three": {"n": 3}}, []
    path.write_text(json.dumps({"gone": {}, "two": {"square": 4, "made_with": "today"}, "three": {"square": 8}}))
    monkeypatch.setattr(recorded.fresh, "stamp", lambda file: "today")
    monkeypatch.setattr(sys, "argv", ["script"])

    def measure(n):
        if made == [1] and n == 3:
            made.append("ended")
            raise KeyboardInterrupt
        made.append(n)
        return {"square": n * n}

    with pytest.raises(KeyboardInterrupt):
        recorded.run_cases(path, cases, {}, measure, lambda record: None)
    pages = []
    recorded.run_cases(path, cases, {}, measure, pages.append)
    assert made == [1, "ended", 3]
    assert list(pages[0].values()) == [{"square": 1}, {"square": 4}, {"square": 9}]
    assert list(json.loads(path.read_text())) == list(cases)
    monkeypatch.setattr(sys, "argv", ["script", "all"])
    recorded.run_cases(path, cases, {}, measure, lambda record: None)
    assert made[3:] == [1, 2, 3]


def test_tables_are_asked_for_by_name_or_by_a_part_of_it():
    assert [table.name for table in fresh.asked_for(["paper/results/comparison"])] == ["paper/results/comparison"]
    assert {table.name for table in fresh.asked_for(["results/comparison", "tracking/jet"])} == {
        "paper/results/comparison",
        "paper/results/comparison-full",
        "tracking/jet",
    }
