"""python -m tactape_fab.sense.benchmark: write a data set of contacts, answer it, score answers."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError, TactapeError, refuse, tried
from tactape_fab.base.input_file import sha256_of
from tactape_fab.base.output_file import refuse_taken_place, write_file
from tactape_fab.base.plain_text import one_line
from tactape_fab.sense.benchmark.adapters import ADAPTERS, answer_lines, changed_files, open_benchmark, read_index
from tactape_fab.sense.benchmark.answers import is_answers, read_answers
from tactape_fab.sense.benchmark.conditions import CONDITIONS
from tactape_fab.sense.benchmark.score import HEADER, calibration_lines, line, read_truth, score
from tactape_fab.sense.benchmark.write import INDEX, USUAL_FRAMES, USUAL_SEED, truth_path, write_benchmark

_FAILED, _USAGE = 1, 2
_OPTIONS = {"output": "-o", "folder": "FOLDER", "frames": "--frames", "seed": "--seed", "only": "--only"}


def _progress(what: str, done: int, total: int) -> None:
    if sys.stderr is not None and (done == total or done % 50 == 0):
        print(f"{what} {done} of {total}", file=sys.stderr, flush=True)


def _write(given: argparse.Namespace) -> int:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # SIGTERM removes the unfinished folder
    sums = write_benchmark(given.folder, frames=given.frames, seed=given.seed, only=given.only, progress=_progress)
    print("\n".join(f"{value}  {name}" for name, value in sums.items()))
    return 0


def _check(given: argparse.Namespace) -> int:
    changed, index = changed_files(given.folder), read_index(given.folder)
    for name, value in index["files"].items():
        print(one_line(f"{value}  {name}{'  changed' if name in changed else ''}"))
    print(f"{sha256_of(Path(given.folder) / INDEX)}  {INDEX}")
    return _FAILED if changed else 0


def _answer(given: argparse.Namespace) -> int:
    output = Path(given.output)
    refuse_taken_place(output, "output", overwrite=given.overwrite, ours=is_answers, kind="no file of answers")
    lines = answer_lines(given.method, ADAPTERS[given.method], open_benchmark(given.folder), _progress)
    write_file(output, "".join(f"{text}\n" for text in lines).encode(), "output", overwrite=given.overwrite)
    return 0


def _score(given: argparse.Namespace) -> int:
    truth = read_truth(given.truth or truth_path(Path(given.folder)))
    problems: list[Problem] = []
    found = [tried(partial(read_answers, path, len(truth)), problems) for path in given.answers]
    refuse(problems)  # before the first score is printed
    for method, answers in filter(None, found):
        print(one_line(f"{method}: {len(answers)} answers for {len(truth)} frames"), "", *HEADER, sep="\n")
        print(*(one_line(line(name, row)) for name, row in score(answers, truth).items()), "", sep="\n")
        print(*calibration_lines(answers, truth), "", sep="\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tactape_fab.sense.benchmark", description="See docs/benchmark.md.")
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    write = actions.add_parser("write", help="simulate the frames; their truth goes beside the folder")
    write.add_argument("--frames", type=int, default=USUAL_FRAMES, metavar="N", help=f"of each condition; usually {USUAL_FRAMES}")
    write.add_argument("--seed", type=int, default=USUAL_SEED, metavar="S", help=f"usually {USUAL_SEED}")
    conditions = ", ".join(CONDITIONS).replace("%", "%%")  # argparse fills a help text in as a format
    write.add_argument("--only", action="append", default=[], metavar="CONDITION", help=f"one or several of: {conditions}")
    check = actions.add_parser("check", help="compare the files with their sums")
    answer = actions.add_parser("answer", help="locate the frames by a method of this package")
    answer.add_argument("-o", "--output", required=True, metavar="FILE.jsonl")
    answer.add_argument("--method", choices=tuple(ADAPTERS), default="ml")
    answer.add_argument("--overwrite", action="store_true")
    scored = actions.add_parser("score", help="score files of answers, of any method")
    for one, act in ((write, _write), (check, _check), (answer, _answer), (scored, _score)):
        one.add_argument("folder", metavar="FOLDER")
        one.set_defaults(act=act)
    scored.add_argument("answers", nargs="+", metavar="ANSWERS.jsonl")
    scored.add_argument("--truth", metavar="FILE", help="instead of FOLDER-truth.jsonl")
    return parser


def _as_typed(problem: Problem) -> str:
    """A problem's message, whose key is replaced by the option as typed."""
    return problem.message.replace(f"{problem.key} = ", f"{_OPTIONS.get(problem.key, problem.key)} = ", 1)


def main(words: Sequence[str] | None = None) -> int:
    """Do what the words say; the exit status (as the other commands: 1 failed, 2 a value that is refused)."""
    given = _parser().parse_args(words)
    try:
        done = int(given.act(given))
        sys.stdout.flush()
        return done
    except BrokenPipeError:  # whoever reads has enough; nothing is left to flush at the end of the process
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _FAILED
    except TactapeError as error:
        problems = [_as_typed(problem) for problem in error.problems] if isinstance(error, SpecError) else str(error).splitlines()
        print("\n".join(f"error: {one_line(problem)}" for problem in problems), file=sys.stderr)
        return _USAGE if isinstance(error, SpecError) else _FAILED


if __name__ == "__main__":
    sys.exit(main())
