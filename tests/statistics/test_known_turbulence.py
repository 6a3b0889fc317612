"""Statistics of 200 fields whose turbulence is known: the benchmark's case, one draw of it."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from plenopiv.statistics.variables import INTERVAL

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "statistics" / "error_bars.py"


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("statistics_error_bars", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.full
@pytest.mark.parametrize("case", ["independent", "correlated, T = 4"])
def test_mean_rms_and_stresses_are_within_their_intervals(benchmark, case):
    found, truth = benchmark.statistics_of(7, *benchmark.CASES[case])
    shares = {}
    for name, value in truth.items():
        inside = np.abs(found[name] - value) < INTERVAL * found[f"{name}_std"]
        shares.setdefault(benchmark.group(name), []).append(100 * float(inside.mean()))
    for kind, values in shares.items():
        if kind != "skewness":
            assert 90 <= np.mean(values) <= 98, (kind, values)


def test_the_recorded_shares_are_those_that_the_page_states():
    """Mean, RMS and stresses of 200 fields within their 95 % intervals in 90 to 98 % of places."""
    recorded = json.loads(BENCHMARK.with_suffix(".json").read_text())["cases"]
    page = (BENCHMARK.parents[2] / "docs" / "statistics.md").read_text()
    of_200 = {name: case for name, case in recorded.items() if case["fields"] == 200}
    assert len(of_200) == 5
    for name, case in of_200.items():
        line = next(line for line in page.splitlines() if line.startswith(f"| {name} |"))
        for kind, share in case["within"].items():
            assert f"| {share:.1f} " in line
            assert kind == "skewness" or 90 <= share <= 98, (name, kind)
