"""Mutation campaign: would the quick tests notice a wrong sign, constant, comparison or axis?

Sixty-seven mutants of the measuring chain, seven of them named and sixty drawn by a seed, are tried one at a time in a
copy of the project, outside the working tree: first the tests nearest to the mutated file, then all other quick ones,
up to the first that fails. A mutant that no test fails on has survived. Then either a test is missing, or the mutant
changes nothing that matters: such are listed by hand, with the reason, in equivalent_mutants.toml.

    campaigns/mutations.py            try what has no result yet; call it again to go on after a stop
    campaigns/mutations.py list       the mutants, what each changes, and its result so far
    campaigns/mutations.py table      write docs/mutations.md from the results

Results are in campaigns/results/mutations.json. A result holds as long as the mutated function stays as it is;
survivors are tried again, after tests were added, with --again survivors.
"""

from __future__ import annotations

import argparse
import hashlib
import signal
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue

sys.path.insert(0, str(Path(__file__).parent))

from mutation_plan import COUNT, SEED, Mutant, Plan, PlanError, nearest
from mutation_results import Results, equivalents, machine
from mutation_runs import Options, Outcome, Processes, RunError, Tree, locked
from mutation_table import table

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "campaigns" / "results" / "mutations.json"
EQUIVALENT = ROOT / "campaigns" / "equivalent_mutants.toml"
TABLE = ROOT / "docs" / "mutations.md"


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", nargs="?", choices=("run", "list", "table"), default="run")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time, one compute thread each (2)")
    parser.add_argument("--nearest-only", action="store_true", help="only the nearest tests: a first sieve, in minutes")
    parser.add_argument("--again", metavar="WHICH", help="try again: survivors, all, or part of a mutant's name")
    parser.add_argument("--only", metavar="PART", help="only mutants with this in their area or name")
    parser.add_argument(
        "--timeout", type=float, default=20.0, help="minutes after which a mutant counts as caught (20)"
    )
    parser.add_argument("--test-timeout", type=float, default=5.0, help="minutes of one test, likewise (5)")
    parser.add_argument("-n", "--workers", type=int, default=0, help="pytest-xdist's workers for each mutant (0: none)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the draw ({SEED})")
    parser.add_argument("--count", type=int, default=COUNT, help=f"mutants drawn ({COUNT})")
    parser.add_argument("--trust", action="store_true", help="do not run the tests without a mutant first")
    parser.add_argument("--work", type=Path, help="folder for the copies (of the system's temporary folder)")
    parser.add_argument("--results", type=Path, default=RESULTS, help="file of results")
    return parser.parse_args(given)


def chosen(mutant: Mutant, part: str | None) -> bool:
    """Whether a mutant's area or name has this in it."""
    return part is None or part in (mutant.area, "all") or part in mutant.key


def wanted(results: Results, mutant: Mutant, options: argparse.Namespace) -> bool:
    """Whether a mutant is to be tried now."""
    if not chosen(mutant, options.only):
        return False
    known = results.of(mutant)
    if known is None or (known["result"] == "survived" and known["tests"] == "nearest" and not options.nearest_only):
        return True
    if options.again == "survivors":
        return known["result"] == "survived"
    return options.again is not None and chosen(mutant, options.again)


class Campaign:
    """Tries mutants in ``trees``, as many at a time as there are."""

    def __init__(self, plan: Plan, results: Results, options: argparse.Namespace):
        self.plan, self.results, self.options = plan, results, options
        self.todo = [m for m in self.settled() if wanted(results, m, options)]
        self.total, self.done = len(self.todo), 0

    def settled(self) -> list[Mutant]:
        """The plan's mutants, those replaced that are known to be none."""
        for mutant in list(self.plan.drawn):
            following: Mutant | None = mutant
            while following and (self.results.of(following) or {}).get("result") == "not viable":
                following = self.plan.replace(following)
        return self.plan.mutants

    def run(self, trees: list[Tree], how: Options) -> None:
        """Try all; results are written one by one."""
        free: SimpleQueue[Tree] = SimpleQueue()
        for tree in trees:
            free.put(tree)

        def tried(mutant: Mutant) -> Outcome:
            tree = free.get()
            try:
                return tree.tried(mutant, how)
            finally:
                free.put(tree)

        with ThreadPoolExecutor(len(trees)) as pool:
            running: dict[Future[Outcome], Mutant] = {}
            try:
                while self.todo or running:
                    while self.todo and len(running) < len(trees):
                        mutant = self.todo.pop(0)
                        running[pool.submit(tried, mutant)] = mutant
                    # A wait without end would miss a signal that comes just before it.
                    for future in wait(running, timeout=0.5, return_when=FIRST_COMPLETED).done:
                        self.record(running.pop(future), future.result())
            except BaseException:
                for tree in trees:
                    tree.processes.stop()
                raise

    def record(self, mutant: Mutant, outcome: Outcome) -> None:
        """Keep a result, and draw another one for a mutant that is none."""
        self.results.add(mutant, outcome)
        self.done += 1
        by = f" by {outcome.by}" if outcome.by else ""
        print(f"[{self.done}/{self.total}] {outcome.result}{by}, {outcome.seconds:.0f} s: {mutant.key}", flush=True)
        if outcome.result == "not viable" and mutant in self.plan.drawn:
            following = self.plan.replace(mutant)
            while following and not wanted(self.results, following, self.options):
                known = self.results.of(following)
                following = self.plan.replace(following) if known and known["result"] == "not viable" else None
            if following:
                self.todo.append(following)
                self.total += 1


def tests_and_sources(root: Path) -> str:
    """A hash of all sources and tests."""
    digest = hashlib.sha256()
    for path in sorted([*(root / "src").rglob("*.py"), *(root / "tests").rglob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@contextmanager
def stopped_by_signals(processes: Processes) -> Iterator[None]:
    """A signal ends the processes, and the campaign where it next asks for one: nothing is cut off half-way."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    for number in before:
        signal.signal(number, lambda *_: processes.stop())
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run(options: argparse.Namespace) -> None:
    """Try the mutants that are left."""
    results = Results(options.results)
    campaign = Campaign(Plan(ROOT, options.seed, options.count), results, options)
    if not campaign.todo:
        print("every mutant has a result; --again survivors tries those that no test failed on")
        return
    name = hashlib.sha256(str(ROOT).encode()).hexdigest()[:8]
    work = options.work or Path(tempfile.gettempdir()) / f"plenopiv-mutations-{name}"
    how = Options(60 * options.timeout, 60 * options.test_timeout, options.workers, options.nearest_only)
    processes = Processes()
    with locked(work) as lock, stopped_by_signals(processes):
        trees = [
            Tree(ROOT, work / f"copy {n}", work / "cache", processes, lock, options.jobs > 1)
            for n in range(max(1, min(options.jobs, len(campaign.todo))))
        ]
        trees[0].check()
        state = tests_and_sources(ROOT)
        if not options.trust and results.unmutated.get("state") != state:
            print("first the tests without a mutant", flush=True)
            near = {folder for mutant in campaign.todo for folder in nearest(ROOT, mutant)}
            outcome = trees[0].unmutated(sorted(near) if how.only_nearest else [], how)
            if outcome.by:
                raise RunError(f"a test fails without a mutant: {outcome.by}; the campaign needs all to pass")
            if not how.only_nearest:
                results.passed(state, outcome.seconds)
        results.tried_on(machine() | {"jobs": options.jobs})
        campaign.run(trees, how)
    survivors = [m for m in campaign.plan.mutants if (results.of(m) or {}).get("result") == "survived"]
    known = equivalents(EQUIVALENT)
    left = [m for m in survivors if (m.key, m.becomes) not in known]
    print(f"{len(survivors)} survived, {len(survivors) - len(left)} of them known to be equivalent")
    for mutant in left:
        print(f"no test fails on: {mutant.key}")


def listed(options: argparse.Namespace) -> None:
    """Print the mutants."""
    results = Results(options.results)
    for mutant in Campaign(Plan(ROOT, options.seed, options.count), results, options).plan.mutants:
        if chosen(mutant, options.only):
            known = results.of(mutant) or {"result": "no result yet", "by": ""}
            print(f"{mutant.key}\n  line {mutant.line}: {mutant.was}\n  becomes: {mutant.becomes}")
            print(f"  {known['result']}{' by ' + known['by'] if known['by'] else ''}")


def main(given: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = arguments(given)
    try:
        if options.action == "run":
            run(options)
        elif options.action == "list":
            listed(options)
        else:
            results = Results(options.results)
            plan = Campaign(Plan(ROOT, options.seed, options.count), results, options).plan
            known = equivalents(EQUIVALENT)
            TABLE.write_text(table(plan, results, known, options.seed), encoding="utf-8")
            print(f"wrote {TABLE.relative_to(ROOT)}")
            for key, _ in set(known) - {(m.key, m.becomes) for m in plan.mutants}:
                print(f"{EQUIVALENT.name} has a mutant that is not drawn, or is another by now: {key}")
    except (PlanError, RunError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command goes on where it was", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
