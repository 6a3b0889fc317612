"""The mutation campaign on a project of one module: what is drawn, tried, kept, and shown."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import mutation_plan
import mutations
import pytest
from mutation_plan import AREAS, NAMED, Plan, PlanError
from mutation_results import Results, equivalents
from mutation_runs import Options, Outcome, Processes, RunError, Tree, failed, locked, tracked
from mutation_table import table

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def plan():
    return Plan(ROOT)


def test_the_draw_is_that_of_the_seed(plan):
    """Sixty, as many of each area, kinds alike; every named text is there once, and every pattern finds a file."""
    counts = [sum(m.area == area for m in plan.drawn) for area in AREAS]
    assert sum(counts) == mutation_plan.COUNT
    assert max(counts) - min(counts) <= 1
    assert len({m.key for m in plan.drawn}) == len(plan.drawn)
    assert [m.key for m in Plan(ROOT).mutants] == [m.key for m in plan.mutants]
    assert len(plan.named) == len(NAMED)
    assert not {m.key for m in Plan(ROOT, seed=1).drawn} >= {m.key for m in plan.drawn}
    kinds = [sum(m.kind == kind for m in plan.drawn) for kind in ("sign", "constant", "comparison", "axis order")]
    assert min(kinds) >= 10


def test_a_mutant_that_is_none_gives_way_to_the_next_of_its_area():
    plan = Plan(ROOT)
    gone = plan.drawn[3]
    following = plan.replace(gone)
    assert following.area == gone.area
    assert plan.drawn[3] == following
    assert gone not in plan.drawn


def test_each_mutant_has_tests_near_it(plan):
    for mutant in plan.mutants:
        assert mutation_plan.nearest(ROOT, mutant), mutant.key


def test_patterns_and_texts_that_are_gone_are_told_in_a_line(tmp_path):
    with pytest.raises(PlanError, match=r"area geometry: no file is called src/plenopiv/optics.py"):
        Plan(tmp_path)
    with pytest.raises(PlanError, match="is not once in"):
        mutation_plan.named(tmp_path)


@pytest.mark.parametrize(
    ("status", "said", "by"),
    [
        (0, "3 passed", ""),
        (1, "F\nFAILED tests/a/test_b.py::test_c[x - y] - assert 1 == 2\n1 failed", "tests/a/test_b.py::test_c[x"),
        (1, "E\nERROR tests/a/test_b.py::test_c\n1 error", "tests/a/test_b.py::test_c"),
        (2, "ERROR tests/a/test_b.py - ImportError: no\n1 error", "tests/a/test_b.py"),
        (-11, "", "crash"),
        (1, "..Timeout (0:05:00)!\nThread 0x00007f (most recent call first):\n", "timeout"),
    ],
)
def test_what_pytest_says(status, said, by):
    assert failed(status, said).startswith(by)
    assert bool(failed(status, said)) == bool(by)


def test_pytest_that_does_not_run_is_an_error():
    with pytest.raises(RunError, match="exit status 4"):
        failed(4, "ERROR: file not found: tests/none")


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project of one module and its tests, in a folder with a space; one area, no named mutants."""
    root = tmp_path / "my project"
    (root / "src" / "plenopiv").mkdir(parents=True)
    (root / "tests" / "volume").mkdir(parents=True)
    (root / "src" / "plenopiv" / "__init__.py").write_text("")
    (root / "src" / "plenopiv" / "volume.py").write_text(
        textwrap.dedent("""
        def forwards(n):
            return n + 1

        def endless(n):
            while n > 0:
                n = n - 1
            return n

        def unseen(a):
            return a < 7.5
        """)
    )
    (root / "tests" / "volume" / "test_volume.py").write_text(
        textwrap.dedent("""
        from plenopiv import volume

        def test_forwards():
            assert volume.forwards(1) == 2

        def test_endless():
            assert volume.endless(3) == 0
        """)
    )
    (root / "pyproject.toml").write_text("[tool.pytest.ini_options]\nmarkers = ['full: slow']\n")
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    subprocess.run(["git", "add", "-A"], cwd=root, check=True)
    monkeypatch.setattr(mutation_plan, "AREAS", {"units": ("volume.py",)})
    monkeypatch.setattr(mutation_plan, "NAMED", [])
    return root


def contents(root):
    return {name: (root / name).read_bytes() for name in tracked(root)}


@pytest.mark.full
def test_each_outcome(project, tmp_path):
    """Caught by a test, by the clock, and not at all; the project stays as it is, and so does the copy in the end."""
    before, plan = contents(project), Plan(project, count=100)
    by_key = {m.key.split("volume.py:")[1]: m for m in plan.drawn}
    with locked(tmp_path / "work here") as lock:
        tree = Tree(project, tmp_path / "work here" / "copy", tmp_path / "cache", Processes(), lock, True)
        tree.check()
        assert tree.unmutated([], Options()).by == ""
        sign = tree.tried(by_key["forwards:sign:0"], Options())
        assert (sign.result, sign.by) == ("caught", "tests/volume/test_volume.py::test_forwards")
        assert sign.tests == "nearest"
        for limits in (Options(timeout_s=2.0), Options(test_s=1.0)):
            loop = tree.tried(by_key["endless:sign:0"], limits)
            assert (loop.result, loop.by) == ("caught", "timeout")
            assert loop.seconds < 30
        blind = tree.tried(by_key["unseen:comparison:0"], Options(only_nearest=True))
        assert (blind.result, blind.by, blind.tests) == ("survived", "", "nearest")
        with pytest.raises(RunError, match="another campaign"), locked(tmp_path / "work here"):
            pass
    assert contents(project) == before
    assert {name: (tree.folder / name).read_bytes() for name in before} == before


def test_results_hold_for_the_same_function_alone(project, tmp_path):
    plan, results = Plan(project, count=100), Results(tmp_path / "kept" / "results.json")
    mutant = next(m for m in plan.drawn if "forwards:sign" in m.key)
    results.add(mutant, Outcome("caught", "tests/a.py::test_b", "nearest", 1.23))
    assert Results(results.path).of(mutant)["by"] == "tests/a.py::test_b"
    path = project / "src" / "plenopiv" / "volume.py"
    path.write_text("\n\n" + path.read_text().replace("n > 0", "n != 0"))  # another function, other lines
    again = {m.key: m for m in Plan(project, count=100).drawn}
    assert results.of(again[mutant.key])
    path.write_text(path.read_text().replace("return n + 1", "return n + 1.0"))
    again = {m.key: m for m in Plan(project, count=100).drawn}
    assert results.of(again[mutant.key]) is None
    assert not list(results.path.parent.glob("*.new"))


def test_what_is_tried_again(project, tmp_path):
    results = Results(tmp_path / "results.json")
    plan = Plan(project, count=100)
    caught, near, blind, untried = plan.drawn[:4]
    results.add(caught, Outcome("caught", "t", "nearest", 1))
    results.add(near, Outcome("survived", "", "nearest", 1))
    results.add(blind, Outcome("survived", "", "quick", 1))

    def tried(*arguments):
        options = mutations.arguments([*arguments])
        return [m for m in plan.drawn[:4] if mutations.wanted(results, m, options)]

    assert tried() == [near, untried]
    assert tried("--nearest-only") == [untried]
    assert tried("--again", "survivors") == [near, blind, untried]
    assert tried("--again", "all") == [caught, near, blind, untried]
    assert tried("--only", untried.key) == [untried]
    assert tried("--only", "nothing") == []


def test_the_table(project, tmp_path, monkeypatch):
    monkeypatch.setattr("mutation_table.AREAS", {"units": ()})
    results, plan = Results(tmp_path / "results.json"), Plan(project, count=4)
    for mutant, outcome in zip(
        plan.drawn,
        [
            Outcome("caught", "tests/a/test_b.py::test_c[1]", "nearest", 2),
            Outcome("survived", "", "quick", 9),
            Outcome("survived", "", "quick", 9),
            Outcome("survived", "", "nearest", 9),
        ],
        strict=True,
    ):
        results.add(mutant, outcome)
    listed = tmp_path / "equivalent.toml"
    third = plan.drawn[2]
    entry = f"key = {json.dumps(third.key)}\nbecomes = {json.dumps(third.becomes)}\n"
    listed.write_text(f'[[mutant]]\n{entry}reason = """no\n matter"""\n')
    page = table(plan, results, equivalents(listed), 7)
    assert "| all drawn | 4 | 1 | 1 | 1 | 1 |" in page
    assert "1 of 2 (50.0%)" in page
    assert "caught by `a/test_b.py::test_c`" in page
    assert f"- `{third.key}`: no matter" in page
    assert str(tmp_path) not in page


def test_equivalent_mutants_have_a_reason_and_no_result_against_them(plan):
    """A mutant that a test fails on is not equivalent."""
    results, known = Results(mutations.RESULTS), equivalents(mutations.EQUIVALENT)
    caught = {(m.key, m.becomes) for m in plan.mutants if (results.of(m) or {}).get("result") == "caught"}
    assert all(len(reason) > 40 for reason in known.values())
    assert not caught & set(known)


def test_a_killed_campaign_leaves_the_project_alone(project, tmp_path):
    """Killed while a mutant runs for ever: no mutated source, and the copies are locked until its test has ended."""
    before, work, script = contents(project), tmp_path / "work", tmp_path / "campaign.py"
    script.write_text(
        textwrap.dedent(f"""
        import sys
        sys.path.insert(0, {str(ROOT / "campaigns")!r})
        from pathlib import Path
        import mutation_plan, mutations
        mutation_plan.AREAS, mutation_plan.NAMED = {{"units": ("volume.py",)}}, []
        mutations.ROOT = Path({str(project)!r})
        sys.exit(mutations.main(sys.argv[1:]))
        """)
    )
    command = [sys.executable, str(script), "--only", "endless:sign", "--count", "100", "--jobs", "1", "--trust"]
    command += ["--work", str(work), "--results", str(tmp_path / "results.json")]
    campaign = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    copy, end = work / "copy 0" / "src" / "plenopiv" / "volume.py", time.monotonic() + 60
    while not (copy.is_file() and "n + 1\n    return n\n" in copy.read_text()):
        assert time.monotonic() < end, campaign.communicate()[0]
        time.sleep(0.05)
    os.kill(campaign.pid, signal.SIGTERM)
    said, _ = campaign.communicate(timeout=60)
    assert campaign.returncode == 130
    assert said.splitlines()[-1] == "stopped; the same command goes on where it was"
    assert contents(project) == before
    with locked(work):
        pass
