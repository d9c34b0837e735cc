"""The count of false accepts: its frames do not depend on how it is cut, its file can be taken up again, its bound is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from tactape_fab import Localization
from tests.bench.false_accepts import (
    COMMON_DOTS,
    OTHERS,
    SECTORS_DEPTH,
    SECTORS_DOTS,
    Record,
    bound_of,
    by_subject,
    jobs_of,
    plan,
    sources,
    table,
    worst_jobs,
)
from tests.bench.false_tally import Tally, total, upper_bound
from tests.bench.localization_false import PART, SCENES, Job, count, depth_frames, dots_frames, draw_part, fewest_lines, replay
from tests.bench.localization_false import _poses as poses_of
from tests.bench.localization_rows import tape_of
from tests.thorough import thorough

JOB = Job(kind="trial", subject="sector 24", level="dots", contact="8x8 mm")


def fix(p_tape: float, p_place: float, located: bool = False) -> Localization:
    return Localization(status="solid", located=located, p_tape=p_tape, p_place=p_place, p_false=min(1.0, p_tape + p_place))


def counted(*fixes: Localization) -> Tally:
    tally = Tally()
    for k, one in enumerate(fixes):
        tally.add(f"frame {k}", "8x8 mm", one)
    return tally


def test_a_tally_counts_decades_and_keeps_the_least() -> None:
    tally = counted(fix(0.05, 0.0), fix(1e-3, 1e-9), fix(0.0, 0.2), Localization(status="none", located=False))
    assert tally.frames == 4
    assert tally.decades["p_tape"][:4] == [3, 2, 2, 1]
    assert tally.least == {"p_false": 1e-3 + 1e-9, "p_tape": 0.0, "p_place": 0.2}  # where p_tape refuses, it is not asked
    assert (tally.where["p_tape"], tally.where["p_place"]) == ("frame 2", "frame 2")
    both = total([tally, counted(fix(1e-6, 0.0, located=True))])
    assert (both.frames, both.located, dict(both.by), both.accepted) == (5, 1, {"8x8 mm": 1}, ["frame 0"])
    assert both.decades["p_tape"][:6] == [4, 3, 3, 2, 2, 2]
    assert Tally.from_mapping(both.to_mapping()) == both


@pytest.mark.parametrize(("sector", "part", "frame"), [thorough(104, 0, 719), thorough(4, 1, 383)])
def test_a_tape_that_nobody_registered_is_known_over_its_own_edge(sector: int, part: int, frame: int) -> None:
    job = Job(kind=SECTORS_DOTS, subject=f"sector {sector}", level="dots", part=part)
    found = replay(job, frame)
    assert found.p_tape is not None and found.p_tape < 1e-5  # nothing else refuses it
    assert not found.located


@pytest.mark.parametrize(("successes", "trials"), [(0, 10000), (1, 10000), (7, 2000), (0, 5)])
def test_at_the_upper_bound_so_few_are_just_in_question(successes: int, trials: int) -> None:
    assert binom.cdf(successes, trials, upper_bound(successes, trials)) == pytest.approx(0.05, rel=1e-6)


def test_the_upper_bound_of_all_is_one() -> None:
    assert upper_bound(5, 5) == 1.0


def test_frames_do_not_depend_on_how_many_are_counted() -> None:
    few, more = count(replace(JOB, frames=3)), count(replace(JOB, frames=6))
    assert (few.frames, more.frames) == (3, 6)
    again = count(replace(JOB, frames=3, kind="another"))
    assert (again.least, again.where, again.decades) == (few.least, few.where, few.decades)
    assert all(a <= b for a, b in zip(few.decades["p_place"], more.decades["p_place"], strict=True))
    drawn, closed = draw_part(JOB, "8x8 mm"), draw_part(replace(JOB, world="closed", frames=5), "8x8 mm")
    assert (drawn.xy_px == closed.xy_px).all()
    for other in (replace(JOB, part=1), replace(JOB, subject="sector 25"), replace(JOB, common=True)):
        assert not np.array_equal(drawn.xy_px[:20], draw_part(other, "8x8 mm").xy_px[:20])
    assert len(list(dots_frames(JOB))) == PART == len(drawn)


def test_depth_maps_are_the_same_when_drawn_again() -> None:
    first, again = (next(depth_frames(replace(JOB, level="depth maps", kind=kind))) for kind in ("a", "b"))
    assert first[0] == "8x8 mm"
    assert np.array_equal(first[1], again[1])


def test_narrow_contacts_feel_two_or_three_lines() -> None:
    tape = tape_of(24)
    contact = "edge, 2-3 lines"
    poses = poses_of(tape, replace(JOB, contact=contact), contact, np.random.default_rng(1))
    lines = fewest_lines(tape, poses[:200], SCENES[contact][0])
    assert set(lines.tolist()) == {2, 3}


def test_the_plan_asks_for_what_the_table_says() -> None:
    jobs = plan(10000, 10000)
    frames: dict[tuple[str, str], int] = {}
    for job in jobs:
        frames[job.kind, job.subject] = frames.get((job.kind, job.subject), 0) + job.frames
    assert [frames[SECTORS_DOTS, f"sector {sector}"] for sector in OTHERS] == [10000] * 255
    assert sum(frames[SECTORS_DEPTH, f"sector {sector}"] for sector in OTHERS) >= 10000
    assert [frames[COMMON_DOTS, f"sector {sector}"] for sector in (6, 8, 23, 24)] == [10000] * 4
    assert {count for (kind, _), count in frames.items() if "world" in kind} == {10000, 2000}
    assert len(set(jobs)) == len(jobs)
    assert {bound_of(kind) for kind, _ in frames if "world" in kind} == {"p_tape"}
    assert {bound_of(kind) for kind, _ in frames if "world" not in kind} == {"p_place"}


def test_counts_of_another_decoder_or_simulator_are_of_other_sources() -> None:
    found = {"/".join(path.parts[-3:]) for path in sources()}
    assert {"sense/decode/accept.py", "decode/search/tally.py", "sense/simulation/draw.py", "kit/profiles/parts.py"} <= found
    assert {"texture/certify/pairs.py", "tactape_fab/sense/sensors.py", "tests/bench/dot_records.py"} <= found


def test_a_file_is_taken_up_where_it_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "counts.jsonl"
    jobs = [*jobs_of(SECTORS_DOTS, "sector 1", "dots", 1500), *jobs_of(SECTORS_DOTS, "sector 2", "dots", 1500)]
    assert [job.frames for job in jobs] == [1000, 500, 1000, 500]
    record = Record.opened(path)
    for k, job in enumerate(jobs):
        record.add(job, counted(fix(1.0, 0.5), fix(1e-5, 0.1 / (k + 1))))
    with path.open("a") as stream:
        stream.write('{"job": {"kind": "oth')
    again = Record.opened(path)
    assert again.done == record.done
    assert Record.opened(path).done == record.done
    assert by_subject(again.done, SECTORS_DOTS)["sector 2"].least["p_place"] == 0.1 / 4
    assert {job.subject for job in worst_jobs(again.done, 10000)} == {"sector 2"}
    assert "sector 2: 0 of 4" in table(again.done)
    again.add(jobs[0], counted(fix(1e-5, 1e-5, located=True)))
    assert {job.subject for job in worst_jobs(again.done, 10000)} == {"sector 1"}
    path.write_text('{"seed": 1}\n')
    with pytest.raises(SystemExit, match="another seed or other sources"):
        Record.opened(path)
