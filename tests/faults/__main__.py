"""Every failing call of every command that writes: `python -m tests.faults [--page docs/limits.md]`, for some minutes.

A fault leaves what was there or what a whole run makes, nothing else of any name, and one line that says why.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.bench.marks import command, write_between
from tests.faults.injected import KINDS, attempt, calls, state
from tests.faults.runs import CASES, prepared, small_kit


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="append", choices=list(CASES), default=[])
    parser.add_argument("--kind", action="append", choices=KINDS, default=[])
    parser.add_argument("--every", type=int, default=1, help="only each N-th call")
    parser.add_argument("--allocations-every", type=int, default=1, help="only each N-th of its allocations")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the table between marks of a page, docs/limits.md")
    asked = parser.parse_args()
    rows, wrong = [], 0
    with tempfile.TemporaryDirectory(prefix="tactape-faults-") as scratch:
        home = Path(scratch).resolve()
        kit = small_kit(home)
        for name in asked.run or CASES:
            case, folder, cells = CASES[name], home / "here", []
            for kind in asked.kind or KINDS:
                before = state(prepared(case, kit, folder))
                case.run(folder)  # what is imported at the first use
                prepared(case, kit, folder)
                count = calls(kind, case.run, folder)
                after = state(folder)
                numbers = range(1, count + 1, asked.allocations_every if kind == "allocation" else asked.every)
                bad = 0
                for number in numbers:
                    found = attempt(kind, number, case.run, prepared(case, kit, folder), before, after)
                    if found.wrong:
                        bad += 1
                        print(f"{name}, {kind} {number} of {count}: {found.wrong}", file=sys.stderr, flush=True)
                cells.append(f"{len(numbers)} of {count}" + (f", **{bad} wrong**" if bad else ""))
                wrong += bad
            rows.append(f"| {name} | {' | '.join(cells)} |")
            print(rows[-1], file=sys.stderr, flush=True)
    kinds = asked.kind or KINDS
    table = f"| run | {' | '.join(kinds)} |\n|---|{'--:|' * len(kinds)}\n" + "\n".join(rows) + "\n"
    print(table)
    if asked.page is not None:
        write_between(asked.page, "faults", f"Failing calls of all that a run makes ({command('tests.faults')}).\n\n{table}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
