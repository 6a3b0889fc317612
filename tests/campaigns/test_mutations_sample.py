"""A sample of the mutation campaign: a few of the mutants that it recorded as caught quickly are caught again."""

import hashlib
from pathlib import Path

import mutations
import pytest
from mutation_plan import Plan
from mutation_results import Results
from mutation_runs import Options, Processes, Tree, locked

ROOT = Path(__file__).parents[2]
SAMPLE = 5
QUICK_S = 15.0


@pytest.mark.full
def test_a_sample_is_caught_again(tmp_path):
    """Drawn by a hash of their names among those that the nearest tests caught within seconds."""
    results = Results(mutations.RESULTS)
    recorded = [(m, results.of(m)) for m in Plan(ROOT).mutants]
    quick = [
        m for m, r in recorded if r and r["tests"] == "nearest" and r["result"] == "caught" if r["seconds"] < QUICK_S
    ]
    assert len(quick) >= SAMPLE, "run campaigns/mutations.py: its results are those of other sources"
    sample = sorted(quick, key=lambda m: hashlib.sha256(f"sample {m.key}".encode()).digest())[:SAMPLE]
    with locked(tmp_path / "work") as lock:
        tree = Tree(ROOT, tmp_path / "work" / "copy", tmp_path / "cache", Processes(), lock, one_thread=False)
        tree.check()
        assert tree.unmutated(sample, Options(only_nearest=True)).by == ""
        found = {m.key: tree.tried(m, Options(only_nearest=True)) for m in sample}
    print("", *(f"{key}: {o.result} by {o.by}, {o.seconds:.0f} s" for key, o in found.items()), sep="\n")
    assert {o.result for o in found.values()} == {"caught"}
