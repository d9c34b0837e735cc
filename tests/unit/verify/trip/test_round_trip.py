"""What a round trip says of its contacts: outcomes counted, the source that is wrong named, measured places worth having."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Tape
from tactape_fab.base.errors import Check, SpecError
from tactape_fab.sense.simulation.parts import parts_of
from tactape_fab.verify.trip import round_trip
from tactape_fab.verify.trip.positions import Source
from tactape_fab.verify.trip.round_trip import (
    BARELY,
    LIMITED,
    LOST,
    MEASURED,
    MISSED,
    NOISY,
    RIGHT,
    WRONG,
    Trip,
    check_measured,
    full_trips,
    quick_trip,
    read_contact,
    trip_checks,
)
from tests.measured import measured
from tests.tapes import tape_at

TAPE = tape_at(7, (30, 24))


def source(name: str = "CPL", shift_mm: float = 0.0) -> Source:
    parts = parts_of(TAPE)
    return Source(name=name, parts=replace(parts, xy_mm=parts.xy_mm + np.array([shift_mm, 0.0])))


def trip(outcomes: Sequence[int], *, tolerated: float = 0.0, name: str = "CPL", reasons: Counter[str] | None = None) -> Trip:
    outcome = np.array(outcomes)
    error_um = np.where(np.isin(outcome, (RIGHT, WRONG)), 1.0 + np.arange(len(outcome)), np.nan)
    poses = np.column_stack([np.arange(len(outcome)) + 0.25, np.arange(len(outcome)) + 0.5, np.arange(len(outcome)) * 10.0])
    return Trip(source=name, poses=poses, outcome=outcome, error_um=error_um, reasons=reasons or Counter(), tolerated=tolerated)


def line(*trips: Trip, sources: Sequence[Source] = ()) -> Check:
    return trip_checks(TAPE, sources or [source(t.source) for t in trips], trips)[0]


@pytest.mark.parametrize(
    ("outcomes", "tolerated", "failed"),
    [
        ([RIGHT, LIMITED, NOISY, BARELY, MISSED], 0.0, False),
        ([RIGHT, WRONG], 0.0, True),
        ([RIGHT, LOST], 0.0, True),
        ([RIGHT, RIGHT, WRONG], 0.34, False),
        ([RIGHT, RIGHT, LOST], 0.34, False),
        ([RIGHT, WRONG, LOST], 0.34, False),
        ([RIGHT, WRONG, WRONG], 0.34, True),
        ([RIGHT, LOST, LOST], 0.34, True),
        ([RIGHT, WRONG], 0.5, False),
        ([WRONG, WRONG], 1.0, False),
    ],
)
def test_so_many_may_be_lost_or_elsewhere_as_are_tolerated(outcomes: list[int], tolerated: float, failed: bool) -> None:
    assert trip(outcomes, tolerated=tolerated).failed is failed


def test_outcomes_are_counted_in_the_line_with_the_errors_of_those_that_are_right() -> None:
    found = line(trip([RIGHT, LIMITED, RIGHT, NOISY, BARELY, BARELY, MISSED, RIGHT]))
    assert (found.name, found.passed, found.warning, found.figure) == ("round trip from CPL", True, False, 3.0)
    p50, p95, p99 = np.percentile([1.0, 3.0, 8.0], [50, 95, 99])
    assert found.message == (
        "3 of 8 contacts located and right, 1 shows too little to be located, 1 not located in the sensor's noise, "
        "2 not located, as it shows barely enough, 1 missed by the decoder; "
        f"error p50 {p50:.1f}, p95 {p95:.1f}, p99 {p99:.1f} um"
    )
    quick = line(trip([RIGHT, RIGHT, LOST, WRONG], tolerated=0.5)).message
    assert quick.startswith(
        "2 of 4 contacts located and right, 1 not located by the quick method, 1 misplaced by the quick method"
    )
    assert line(trip([RIGHT])).message.startswith("1 of 1 contacts located and right; error")


def test_no_contact_at_all_is_a_warning_that_says_what_to_do() -> None:
    full, quick = line(trip([LIMITED, BARELY])), line(trip([LIMITED], tolerated=1.0))
    assert [(check.passed, check.warning, check.figure) for check in (full, quick)] == [(False, True, 0.0)] * 2
    assert full.message.endswith("see what a larger one does with --contact AxB") and full.message.startswith("none of 2 ")
    assert quick.message.endswith("verify without --quick")


def test_the_first_contact_elsewhere_and_what_the_decoder_says_are_named() -> None:
    reasons = Counter({"too few dots": 2, "no grid": 1})
    made = trip([RIGHT, LOST, WRONG, LOST, WRONG, LOST], reasons=reasons)
    found = line(replace(made, error_um=made.error_um * 500.0))
    assert (found.passed, found.warning, found.figure) == (False, False, 1.0)
    assert found.message.split("; ") == [
        "2 of 6 contacts decode to another place, first at x 2.25, y 2.50 mm, 20 deg, 1.500 mm off",
        "3 of 6 contacts are not located though the tape says enough there, first at x 1.25, y 1.50 mm, 10 deg",
        "the decoder says 2 times: too few dots",
    ]


def test_the_source_at_fault_is_named_beside_those_that_decode_right() -> None:
    wrong, right = trip([WRONG, RIGHT]), trip([RIGHT, RIGHT], name="copper")
    shifted = source(shift_mm=0.75)
    first, second = trip_checks(TAPE, [shifted, source("copper")], [wrong, right])
    assert "the CPL is what is wrong: it is shifted by (+0.750, +0.000) mm" in first.message and second.passed
    assert first.message.endswith("; copper decodes right")
    third = replace(right, source="STL")
    many = line(wrong, right, third, sources=[shifted, source("copper"), source("STL")])
    assert many.message.endswith("; copper and STL decode right")
    both = line(wrong, replace(wrong, source="copper"), sources=[shifted, shifted])
    assert "; CPL: it is shifted by " in both.message and "right" not in both.message.rpartition("; ")[2]


def test_a_contact_is_read_with_all_that_is_wrong_in_it() -> None:
    usual, pad = read_contact(), read_contact(size="pad")
    assert (usual.sensor.name, usual.scene.contact_mm, pad.scene.contact) == ("gelsight-mini", (11.0, 9.0), "pad")
    assert read_contact(size=(8.0, 7.0)).scene.contact_mm == (8.0, 7.0)
    for sensor, size, said in (("nowhere.toml", (-1.0, 2.0), 2), ("nowhere.toml", None, 1), ("gelsight-mini", (-1.0, 2.0), 1)):
        with pytest.raises(SpecError) as caught:
            read_contact(sensor, size)
        assert len(caught.value.problems) == said


# Contacts by a stand-in for the decoder


def fix(located: bool, xy_mm: tuple[float, float] = (0.0, 0.0), theta_deg: float = 0.0) -> Any:
    return SimpleNamespace(located=located, position_mm=xy_mm if located else None, theta_deg=theta_deg, reason=None)


@pytest.mark.parametrize(
    ("off_mm", "turn_deg", "right"),
    [
        ((0.0, 0.0), 0.0, True),
        ((0.375, 0.0), 9.9, True),  # a quarter of the pitch
        ((0.376, 0.0), 0.0, False),
        ((0.0, -0.376), 0.0, False),
        ((0.3, 0.3), 0.0, False),
        ((0.0, 0.0), 10.1, False),
        ((0.0, 0.0), -10.1, False),
        ((0.0, 0.0), 355.0, True),
        ((0.0, 0.0), -355.0, True),
        ((0.0, 0.0), 180.0, False),
    ],
)
def test_right_is_within_a_quarter_pitch_and_ten_degrees(off_mm: tuple[float, float], turn_deg: float, right: bool) -> None:
    frame: Any = SimpleNamespace(position_mm=(8.0, 6.0), theta_deg=170.0)
    answer = fix(True, (8.0 + off_mm[0], 6.0 + off_mm[1]), 170.0 + turn_deg)
    assert round_trip._is_right(TAPE, frame, answer) is right
    assert not round_trip._is_right(TAPE, frame, fix(False))


def test_contacts_are_sorted_into_their_outcomes(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [SimpleNamespace(depth=k, position_mm=(5.0 + k, 5.0), theta_deg=0.0) for k in range(4)]

    def drawn(*_: object, **__: object) -> Iterator[Any]:
        yield from frames

    answers = {0: fix(True, (5.003, 5.0)), 1: fix(False), 2: fix(True, (7.0, 9.0)), 3: replace_reason(fix(False), "too few dots")}
    monkeypatch.setattr(round_trip, "iterate_frames", drawn)
    contact, done, asked = read_contact(), [], []

    def outcome_of_miss(number: int, pose: Any) -> int:
        asked.append(number)
        return BARELY

    poses = np.zeros((4, 3))
    locate: Any = answers.__getitem__
    made = round_trip._trip(TAPE, source(), poses, contact.sensor, contact.scene, locate, outcome_of_miss, lambda: done.append(1))
    assert made.outcome.tolist() == [RIGHT, BARELY, WRONG, BARELY] and asked == [1, 3] and len(done) == 4
    assert made.error_um[[0, 2]] == pytest.approx([3.0, 4000.0]) and np.isnan(made.error_um[[1, 3]]).all()
    assert made.reasons == {"no answer": 1, "too few dots": 1}


def replace_reason(answer: Any, reason: str) -> Any:
    answer.reason = reason
    return answer


@pytest.mark.parametrize(
    ("by_places", "by_design", "scattered", "passed", "warning"),
    [
        (([RIGHT] * 3, 2.0), ([RIGHT] * 3, 9.0), True, True, False),
        (([RIGHT] * 3, 9.0), ([RIGHT] * 3, 9.0), True, False, True),  # no better, where parts scatter
        (([RIGHT] * 3, 9.0), ([RIGHT] * 3, 2.0), False, True, False),  # they hardly scatter
        (([RIGHT] * 3, 9.0), ([RIGHT] * 3, 2.0), True, False, True),
        (([RIGHT, RIGHT, LIMITED], 2.0), ([RIGHT] * 3, 9.0), True, False, True),
        (([RIGHT, RIGHT, WRONG], 2.0), ([RIGHT, LIMITED, LIMITED], 9.0), True, False, False),
        (([RIGHT] * 3, 2.0), ([RIGHT, WRONG, WRONG], 9.0), True, True, False),
        (([RIGHT] * 3, 2.0), ([LIMITED] * 3, 9.0), True, True, False),
        (([LIMITED] * 3, 2.0), ([LIMITED] * 3, 9.0), True, False, True),
    ],
)
def test_measured_places_pass_where_they_are_of_use(
    by_places: tuple[list[int], float],
    by_design: tuple[list[int], float],
    scattered: bool,
    passed: bool,
    warning: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known: list[Tape] = []

    class Decoder:
        def __init__(self, tapes: Sequence[Tape], *_: object) -> None:
            known.extend(tapes)

        def locate(self, depth: object) -> None: ...

    def made(*_: object) -> Trip:
        outcomes, error_um = by_places if len(known) == 1 else by_design
        done = trip(outcomes)
        return replace(done, error_um=np.where(done.outcome == RIGHT, error_um, np.nan))

    monkeypatch.setattr("tactape_fab.sense.decode.localizer.Localizer", Decoder)
    monkeypatch.setattr(round_trip, "_trip", made)
    tape, _ = measured(tape_at(7, (12, 10)), 0.05, missing=0.02, error_mm=0.0)
    assert tape.as_built is not None
    scatter_mm = tape.as_built.scatter_mm
    monkeypatch.setattr(round_trip, "SEEN_MM", scatter_mm if scattered else np.nextafter(scatter_mm, 1.0))
    check = check_measured(tape)
    assert (check.name, check.passed, check.warning) == ("round trip from as-built", passed, warning)
    assert [of.as_built is None for of in known] == [False, True]
    right = by_places[0].count(RIGHT)
    assert check.figure == right
    elsewhere = " and 1 elsewhere" if WRONG in by_places[0] else ""
    error = f"{by_places[1]:.1f}" if right else "inf"
    assert check.message.startswith(
        f"of {MEASURED} contacts of the measured parts by the measured places {right} right{elsewhere}, "
    )
    assert f"error p50 {error} um, by the design's " in check.message
    useful = passed or "elsewhere" in check.message
    assert check.message.endswith("they bring nothing; measure again, or delete as-built.json") is not useful


def test_parts_in_place_that_the_quick_method_misses_are_its_own_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    def bad(*_: object) -> Trip:
        return trip([LOST] * 5 + [RIGHT])

    monkeypatch.setattr(round_trip, "_trip", bad)
    own = quick_trip(TAPE, source())
    assert (own.tolerated, own.failed) == (1.0, False)
    other = quick_trip(TAPE, source(shift_mm=0.75))
    assert other.failed and 0.0 < other.tolerated < 0.5
    monkeypatch.setattr(round_trip, "_trip", lambda *_: trip([RIGHT] * 6))
    assert quick_trip(TAPE, source()).tolerated == other.tolerated


def test_a_quick_trip_locates_its_contacts() -> None:
    made = quick_trip(TAPE, source())
    assert made.outcome.tolist() == [RIGHT] * 6 and made.error_um.max() < 100.0


def test_contacts_that_the_quick_method_misses_are_lost_where_error_free_symbols_suffice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactape_fab.sense.decode.paper.locate_paper", lambda *_, **__: [fix(False)])
    made = quick_trip(TAPE, source())
    assert made.outcome.tolist() == [LOST] * 6 and made.tolerated == 1.0


@dataclass
class Drawn:
    """What `full_trips` asks its stand-ins for."""

    poses: list[tuple[int, int, bool]] = field(default_factory=list)
    excuses: list[Any] = field(default_factory=list)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Drawn:
    asked = Drawn()

    def poses(_: Tape, count: int, seed: int, *__: object, edge: bool) -> Any:
        asked.poses.append((count, seed, edge))
        return np.zeros((count, 3))

    def made(*arguments: Any) -> Trip:
        asked.excuses.append(arguments[6])
        for _ in arguments[2]:
            arguments[7]()
        return trip([RIGHT])

    monkeypatch.setattr(round_trip, "draw_poses", poses)
    monkeypatch.setattr(round_trip, "_trip", made)
    monkeypatch.setattr("tactape_fab.sense.decode.localizer.Localizer", lambda *_: SimpleNamespace(locate=None))
    monkeypatch.setattr("tactape_fab.verify.trip.limit.rule_of", lambda *rest: len(rest))
    return asked


@pytest.mark.parametrize(
    ("code", "counts", "each"),
    [("microdots-4x4", (12, 4), (6, 2)), ("microdots-4x4", (7, 1), (3, 1)), ("anoto-6x6", (24, 4), (3, 1))],
)
def test_contacts_are_divided_among_the_sources(code: str, counts: tuple[int, int], each: tuple[int, int], drawn: Drawn) -> None:
    steps: list[tuple[int, int]] = []
    tape = tape_at(7, (10, 10), code=code)
    trips = full_trips(tape, [source(), source("copper")], None, lambda _, *step: steps.append(step), counts=counts)
    assert len(trips) == 2
    assert drawn.poses == [(n, seed, edge) for seed in (0, 1) for n, edge in zip(each, (False, True), strict=True)]
    total = 2 * sum(each)
    assert steps == [(done, total) for done in range(total + 1)]


@pytest.mark.parametrize(
    ("error_free", "as_seen", "stricter", "placed", "outcome"),
    [
        (False, True, True, True, LIMITED),
        (True, False, True, True, NOISY),
        (True, True, False, True, BARELY),
        (True, True, True, True, MISSED),
        (True, True, True, False, LOST),
    ],
)
def test_what_is_not_located_is_excused_by_the_first_reason(
    error_free: bool, as_seen: bool, stricter: bool, placed: bool, outcome: int, drawn: Drawn, monkeypatch: pytest.MonkeyPatch
) -> None:
    def seen(rule: int, *_: object, known_parts: bool) -> Any:
        assert known_parts == (rule == 2)  # the stricter rule has one argument more
        return fix(as_seen if known_parts else stricter)

    monkeypatch.setattr("tactape_fab.verify.trip.limit.error_free", lambda *_: fix(error_free))
    monkeypatch.setattr("tactape_fab.verify.trip.limit.as_seen", seen)
    monkeypatch.setattr(round_trip, "frame_at", lambda *_: SimpleNamespace(depth=None))
    monkeypatch.setattr(round_trip, "in_place", lambda *_: placed)
    monkeypatch.setattr(round_trip, "parts_shown", lambda *_: None)
    full_trips(TAPE, [source()], counts=(1, 1))
    assert drawn.excuses[0](0, np.zeros(3)) == outcome
