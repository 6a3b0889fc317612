"""A sample of the mutation campaign: a few of the mutants that it recorded as caught quickly are caught again."""

import hashlib
import os
from pathlib import Path

import mutations
import pytest
from mutation_plan import Plan
from mutation_results import Results
from mutation_runs import Options, Processes, Tree, locked

ROOT = Path(__file__).parents[2]
SAMPLE, AMONG = 5, 20  # mutants, of those that were caught soonest
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


@pytest.mark.full
def test_a_sample_is_caught_again(tmp_path):
    """Drawn by a hash of their names. The tests that caught them pass without a mutant."""
    results, options = Results(mutations.RESULTS), Options(only_nearest=True)
    recorded = {m: found for m in Plan(ROOT).mutants if (found := results.of(m))}
    by_a_test = [m for m, found in recorded.items() if found["result"] == "caught" and "::" in found["by"]]
    near = [m for m in by_a_test if recorded[m]["tests"] == "nearest"]
    assert len(near) >= AMONG, "the results are those of other sources: run campaigns/mutations.py"
    soonest = sorted(near, key=lambda m: recorded[m]["seconds"])[:AMONG]
    sample = sorted(soonest, key=lambda m: hashlib.sha256(f"sample {m.key}".encode()).digest())[:SAMPLE]
    with locked(tmp_path / "work") as lock:
        tree = Tree(ROOT, tmp_path / "work" / "copy", CACHE, Processes(), lock, one_thread=False)
        tree.check()
        assert tree.unmutated(sorted({recorded[m]["by"].split("[")[0] for m in sample}), options).by == ""
        found = {m.key: tree.tried(m, options) for m in sample}
    print("", *(f"{key}: {o.result} by {o.by}, {o.seconds:.0f} s" for key, o in found.items()), sep="\n")
    assert {o.result for o in found.values()} == {"caught"}
