"""The page of the mutation campaign, docs/mutations.md, from its results."""

from __future__ import annotations

from statistics import median
from typing import Any

from mutation_plan import AREAS, Mutant, Plan
from mutation_results import Results

LEAST = 0.95  # of the mutants drawn that are not equivalent, what the quick tests are to catch

HEAD = """# Mutations: what the quick tests notice

Written by `campaigns/mutations.py table`. Each mutant is one change of the sources: a sign, a constant, a comparison
or the order of two axes. The quick tests (those of `make test`) run on each in turn, the nearest ones first, up to the
first that fails: the mutant is then caught. Named mutants are those that a review found unseen; the others are drawn by
a seed, as many from each area, before anything is known of them. An equivalent mutant changes no result that a user
could tell.
"""


def state(results: Results, known: dict[tuple[str, str], str], mutant: Mutant) -> str:
    """caught, equivalent, not caught, or not tried; what only the nearest tests missed is not tried yet."""
    result = results.of(mutant)
    if result is None:
        return "not tried"
    if result["result"] == "caught":
        return "caught"
    if (mutant.key, mutant.becomes) in known:
        return "equivalent"
    return "not caught" if result["tests"] == "quick" else "not tried"


def table(plan: Plan, results: Results, known: dict[tuple[str, str], str], seed: int) -> str:
    """The page as Markdown."""
    states = {mutant.key: state(results, known, mutant) for mutant in plan.mutants}
    lines = [HEAD, "## Share caught", ""]
    lines += ["| area | mutants | caught | equivalent | not caught | not tried |", "|---|---|---|---|---|---|"]
    for area in ["named", *AREAS]:
        lines.append(_row(area, [states[m.key] for m in plan.mutants if m.area == area]))
    drawn = [states[m.key] for m in plan.drawn]
    lines.append(_row("all drawn", drawn))
    judged = drawn.count("caught") + drawn.count("not caught")
    share = f"{drawn.count('caught')} of {judged} ({drawn.count('caught') / judged:.1%})" if judged else "none yet"
    lines += ["", f"Caught of those drawn that are not equivalent: {share}; at least {LEAST:.0%} is asked for.", ""]
    lines += _measured(plan, results, seed)
    lines += ["", "## Named", "", *_listed(plan.named, states, results)]
    for area in AREAS:
        lines += ["", f"## {area[:1].upper()}{area[1:]}", ""]
        lines += _listed([m for m in plan.drawn if m.area == area], states, results)
    equivalent = [m for m in plan.mutants if states[m.key] == "equivalent"]
    lines += ["", "## Why the equivalent ones are", ""]
    lines += [f"- `{m.key}`: {known[m.key, m.becomes]}" for m in equivalent] or ["There are none."]
    return "\n".join(lines) + "\n"


def _row(area: str, states: list[str]) -> str:
    counts = [len(states), *(states.count(s) for s in ("caught", "equivalent", "not caught", "not tried"))]
    return f"| {area} | " + " | ".join(str(n) if n else "" for n in counts) + " |"


def _listed(group: list[Mutant], states: dict[str, str], results: Results) -> list[str]:
    lines = ["| mutant | was | becomes | result | s |", "|---|---|---|---|---|"]
    for mutant in group:
        result: dict[str, Any] = results.of(mutant) or {}
        said = states[mutant.key]
        if said == "caught":
            said = f"caught by {_short(result['by'])}"
        seconds = f"{result['seconds']:.0f}" if result else ""
        lines.append(f"| {mutant.key} | {_code(mutant.was)} | {_code(mutant.becomes)} | {said} | {seconds} |")
    return lines


def _short(by: str) -> str:
    """A test without its folder and its parameters' values."""
    return f"`{by.removeprefix('tests/').split('[')[0]}`" if "::" in by else by


def _code(text: str) -> str:
    return "`" + text.replace("|", "\\|") + "`"


def _measured(plan: Plan, results: Results, seed: int) -> list[str]:
    found = [result for mutant in plan.mutants if (result := results.of(mutant))]
    about = results.machine
    if not found or not about:
        return []
    caught = [r["seconds"] for r in found if r["result"] == "caught"] or [0.0]
    return [
        f"Seed {seed}; {sum(r['seconds'] for r in found) / 3600:.1f} hours of tests in all, a caught mutant "
        f"{median(caught):.0f} s (median), {max(caught):.0f} s at most; {about['jobs']} at a time on a machine of "
        f"{about['cores']} cores ({about['processor']}; Python {about['python']}, Numba {about['numba']}, "
        f"NumPy {about['numpy']}), with compilation of the mutated kernels.",
    ]
