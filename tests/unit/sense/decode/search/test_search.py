"""The search against a plain enumeration of every place of every tape."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from tactape_fab import Prior, Tape, TapeSpec, default_origin
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense.decode.rule import LEAST_DOTS, OVERHANG_SHARE, PRIOR_SHARE
from tactape_fab.sense.decode.search.evidence import Tables, tables_of
from tactape_fab.sense.decode.search.families import families
from tactape_fab.sense.decode.search.many_tapes import many_buffers
from tactape_fab.sense.decode.search.plane_sites import Sites
from tactape_fab.sense.decode.search.rivals import best_unregistered, rivals
from tactape_fab.sense.decode.search.search import Place, search
from tactape_fab.sense.decode.search.tally import ManyBuffers
from tactape_fab.texture.code import get_code, get_plane
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray
from tactape_fab.texture.plane import encode
from tests.thorough import thorough

GRID = np.array([24.0, 0.0, 3.0, -5.0])
CENTRE = np.array([10.0, 7.0])
SHARE = 0.01


@cache
def usual_tape() -> Tape:
    return examine(TapeSpec(sector=7)).layout.tape


def tape_of(
    sector: int, size: tuple[int, int] = (62, 32), origin: tuple[int, int] | None = None, holes: tuple[tuple[int, int], ...] = ()
) -> Tape:
    like = usual_tape()
    place = default_origin(like.code, sector) if origin is None else origin
    return replace(
        like,
        name=f"s{sector}",
        sector=sector,
        origin=place,
        columns=size[0],
        rows=size[1],
        symbols=encode(get_plane(like.code), sector, place, (size[1], size[0])),
        omitted=np.array(holes, dtype=np.int64).reshape(-1, 2),
        tag=None,
    )


def seen(
    tape: Tape, corner: tuple[int, int], turn: int, rng: np.random.Generator, *, dots: int, doubt: float
) -> tuple[IntArray, FloatArray]:
    """Grid points and soft symbols of a contact on a tape, some of them wrong or beyond its edge."""
    box = np.array(list(product(range(6), range(6))))
    cells = box[np.sort(rng.choice(len(box), dots, replace=False))] + corner
    inside = ((cells >= 0) & (cells < (tape.columns, tape.rows))).all(axis=1)
    symbols = rng.integers(0, 4, len(cells))
    symbols[inside] = tape.symbols[cells[inside, 1], cells[inside, 0]]
    direction = np.array([3, 2, 0, 1])[symbols]  # N W E S as quarter turns from E towards S
    q = np.full((len(cells), 4), doubt / 3)
    q[np.arange(len(cells)), (direction + turn) % 4] = 1.0 - doubt
    q *= rng.uniform(0.9, 1.1, q.shape)
    x, y = cells.T
    nodes = np.stack([(x, y), (-y, x), (-x, -y), (y, -x)][turn], axis=1)
    return nodes + rng.integers(-9, 9, 2), q / q.sum(axis=1, keepdims=True)


def touch_of(seed: int, size: tuple[int, int] = (62, 32), holes: tuple[tuple[int, int], ...] = ()) -> Tape:
    """A tape of a code without a plane: any matrix will do."""
    symbols = np.random.default_rng(seed).integers(0, 4, size[::-1]).astype(np.uint8)
    return replace(tape_of(7, size, holes=holes), name=f"t{seed}", code="touch-1", origin=(0, 0), symbols=symbols)


def bits_at(code: str, sector: int, columns: IntArray, rows: IntArray) -> tuple[IntArray, IntArray]:
    """x and y bits, -1 or 1, of places in the code plane, by the definition."""
    plane = get_code(code).sequences
    assert plane is not None
    main, length = np.array(plane.main.digits), plane.main.length
    u, v = divmod(sector, length)
    x = main[(rows + u + plane.phase_before(columns)) % length]
    y = main[(columns + v + plane.phase_before(rows)) % length]
    return 2 * x - 1, 2 * y - 1


class Places(NamedTuple):
    """Places with enough dots on a tape: quarter turn, column, row, ln E, and whether all dots lie on it."""

    turn: IntArray
    column: IntArray
    row: IntArray
    value: FloatArray
    whole: BoolArray


@cache
def turned(columns: int, rows: int, nodes: bytes, q: bytes) -> list[tuple[FloatArray, list[tuple[slice, slice]], IntArray]]:
    """Of each quarter turn what dots say in each state of a place's bits, where on the tape, and how many do at each place.

    It is the same for all sectors.
    """
    found = []
    k, j = np.frombuffer(nodes, dtype=np.int64).reshape(-1, 2).T
    shares = np.frombuffer(q).reshape(-1, 4)
    for turn in range(4):
        cells = np.stack([(k, j), (j, -k), (-k, -j), (-j, k)][turn], axis=1)
        cells = cells - cells.min(axis=0)
        e, s, w, n = np.roll(shares, -turn, axis=1).T
        x_said, y_said = np.log(2 * np.stack([e + n, w + s])), np.log(2 * np.stack([n + w, e + s]))
        said = np.zeros((len(cells), 5))  # nothing where no part is placed
        said[:, :4] = (x_said[:, None] + y_said[None, :]).reshape(4, -1).T
        wide, high = (int(v) for v in cells.max(axis=0) + 1)
        count = np.zeros((rows + high - 1, columns + wide - 1), dtype=int)
        at = [
            np.s_[high - 1 - row : high - 1 - row + rows, wide - 1 - column : wide - 1 - column + columns]
            for column, row in cells
        ]
        for each in at:
            count[each] += 1
        found.append((said, at, count))
    return found


def enumerate_places(tape: Tape, sector: int, nodes: IntArray, q: FloatArray, *, overhang: bool = True) -> Places:
    """Every place by the definition: planes of bits shifted by each dot's cell, and added."""
    found = []
    rows, columns = np.mgrid[: tape.rows, : tape.columns]
    if tape.code == "touch-1":
        x_bits, y_bits = 2 * (tape.symbols % 2).astype(int) - 1, 2 * (tape.symbols // 2).astype(int) - 1
    else:
        x_bits, y_bits = bits_at(tape.code, sector, columns + tape.origin[0], rows + tape.origin[1])
    states = np.where(tape.placed, 2 * (x_bits > 0) + (y_bits > 0), 4)
    for turn, (said, at, count) in enumerate(turned(tape.columns, tape.rows, nodes.tobytes(), q.tobytes())):
        total = np.zeros(count.shape)
        for of_dot, each in zip(said, at, strict=True):
            total[each] += of_dot.take(states)
        high, wide = count.shape[0] - tape.rows + 1, count.shape[1] - tape.columns + 1
        y, x = np.nonzero(count >= LEAST_DOTS)
        whole = (x >= wide - 1) & (x < tape.columns) & (y >= high - 1) & (y < tape.rows)
        kept = whole | overhang
        x, y, whole = x[kept], y[kept], whole[kept]
        found.append(Places(np.full(len(x), turn), x - wide + 1, y - high + 1, total[y, x], whole))
    return joined(found)


def joined(found: list[Places]) -> Places:
    return Places(*(np.concatenate(values) for values in zip(*found, strict=True)))


def weights_of(found: Places, turns: FloatArray) -> FloatArray:
    """Weight of each place: the turn's share, and what lies over an edge has its own."""
    out = np.empty(len(found.turn))
    for turn in range(4):
        here = found.whole[found.turn == turn]
        for inside in (True, False):
            chosen = (found.turn == turn) & (found.whole == inside)
            share = (1.0 - OVERHANG_SHARE if inside else OVERHANG_SHARE) if here.any() and not here.all() else 1.0
            out[chosen] = turns[turn] * share / max(chosen.sum(), 1)
    return out


TURNS = np.array([0.4, 0.3, 0.2, 0.1])
REGISTRIES = {
    "one": [tape_of(7)],
    "holes": [tape_of(7, holes=((30, 10), (31, 10), (33, 12)))],
    "holes at the edge": [tape_of(7, (30, 20), (0, 0), ((1, 4), (0, 0), (12, 1)))],
    "narrow": [tape_of(7, (4, 40))],
    "mixed": [
        tape_of(7, (30, 20)),
        tape_of(8),
        tape_of(9, (30, 20), (84, 1428)),
        tape_of(20, (4, 40)),
        tape_of(21, holes=((1, 1),)),
    ],
    "many": [tape_of(s, (20, 14)) for s in range(5, 25)],
    "many, holes": [
        tape_of(s, (40, 20), holes=((30, 10), (31, 10), (12, 3), (1, 1)) if s % 3 else ((30, 10), (5, 19))) for s in range(5, 25)
    ],
    "hundreds, close together": [tape_of(s, (14, 11), (s % 20, s // 20)) for s in range(5, 245)],
    "touch": [touch_of(1)],
    "touch, holes": [touch_of(2, holes=((30, 10), (31, 10), (0, 5)))],
    "touch and planes": [touch_of(3), tape_of(8), touch_of(4, (30, 20)), touch_of(5, (4, 40), ((1, 1),)), touch_of(6)],
}


@pytest.mark.parametrize("name", REGISTRIES)
@pytest.mark.parametrize(
    ("corner", "doubt"), [((28, 9), 0.01), ((0, 3), 0.05), ((-3, 4), 0.02), ((10, -2), 0.3), ((-2, -2), 0.02)]
)
def test_search_is_a_plain_enumeration(name: str, corner: tuple[int, int], doubt: float) -> None:
    tapes = REGISTRIES[name]
    rng = np.random.default_rng([len(name), *(v + 10 for v in corner)])
    nodes, q = seen(tapes[0], corner, int(rng.integers(4)), rng, dots=int(rng.integers(12, 28)), doubt=doubt)
    place = search(tapes, families(tapes, open_world=False), nodes, q, TURNS, GRID, CENTRE, None)
    assert place is not None
    each = [enumerate_places(tape, tape.sector, nodes, q) for tape in tapes]
    of = np.repeat(np.arange(len(tapes)), [len(here.turn) for here in each])
    found = joined(each)
    weights = weights_of(found, TURNS)
    score = found.value + np.log(weights)
    best = int(score.argmax())
    assert (place.tape, place.turn) == (of[best], found.turn[best])
    assert tuple(place.cells.min(axis=0)) == (found.column[best], found.row[best])
    assert place.score == pytest.approx(found.value[best], abs=1e-4)
    assert place.weight == pytest.approx(np.log(weights[best]), abs=1e-4)
    others = np.exp(np.delete(score, best) - score[best]).sum()
    slack = 2e-5 if score[best] > 0.0 else np.exp(-4.0)  # what is left out is counted at a bound; without evidence none is sharp
    assert others * (1 - 1e-4) - 1e-6 <= place.others
    counted = place.others != np.inf
    assert place.others <= others * (1 + 1e-4) + slack if counted else score[best] < 0.0
    likelihood = found.value + np.log(TURNS[found.turn])
    lead = likelihood[best] - np.delete(likelihood, best).max()
    assert place.lead <= lead + 1e-4
    assert not counted or place.lead >= min(lead, 8.0) - 1e-4


@pytest.mark.parametrize("name", ["many", "many, holes", "hundreds, close together", "touch and planes", "mixed"])
@pytest.mark.parametrize("dots", [12, 24])
def test_the_best_place_is_found_where_nothing_fits(name: str, dots: int) -> None:
    tapes = REGISTRIES[name]
    rng = np.random.default_rng([len(name), dots])
    nodes, q = seen(touch_of(90), (30, 9), int(rng.integers(4)), rng, dots=dots, doubt=0.02)
    known = families(tapes, open_world=False)
    place = search(tapes, known, nodes, q, TURNS, GRID, CENTRE, None)
    assert place is not None
    each = [enumerate_places(tape, tape.sector, nodes, q) for tape in tapes]
    found = joined(each)
    score = found.value + np.log(weights_of(found, TURNS))
    best = int(score.argmax())
    assert score[best] < 0.0
    assert np.repeat(np.arange(len(tapes)), [len(here.turn) for here in each])[best] == place.tape
    assert (found.turn[best], found.column[best], found.row[best]) == (place.turn, *place.cells.min(axis=0))
    assert place.score + place.weight == pytest.approx(score[best], abs=1e-4)
    # how much others weigh beside a place that says nothing is known, or is not counted
    assert place.others >= np.exp(np.delete(score, best) - score[best]).sum() * (1 - 1e-4)
    assert place.others == np.inf or not name.startswith(("many", "hundreds"))
    below, above = (search(tapes, known, nodes, q, TURNS, GRID, CENTRE, None, least=score[best] + d) for d in (-1.0, 1.0))
    assert below is not None and below.tape == place.tape and below.score == pytest.approx(place.score, abs=1e-4)
    assert above is None


@pytest.mark.parametrize("first", [True, False])
def test_tapes_of_a_code_that_says_nothing_weigh_beside_those_of_another(first: bool) -> None:
    others = [replace(tape_of(s, (20, 14)), name=f"o{s}", code="anoto-6x6") for s in range(25, 45)]
    tapes = [*others, *REGISTRIES["many"]] if first else [*REGISTRIES["many"], *others]
    rng = np.random.default_rng(4)
    nodes, q = seen(tape_of(9, (20, 14)), (8, 4), 1, rng, dots=20, doubt=0.15)
    place = search(tapes, families(tapes, open_world=False), nodes, q, TURNS, GRID, CENTRE, None)
    found = joined([enumerate_places(tape, tape.sector, nodes, q) for tape in tapes])
    score = found.value + np.log(weights_of(found, TURNS))
    assert place is not None and tapes[place.tape].name == "s9"
    rest = np.exp(np.delete(score, score.argmax()) - score.max()).sum()
    assert rest * (1 - 1e-4) - 1e-6 <= place.others <= rest * (1 + 1e-4) + 2e-5


@pytest.mark.parametrize(("name", "known"), [("many", False), ("hundreds, close together", True)])
def test_where_many_sites_stay_open_all_dots_are_added_everywhere(
    name: str, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[ManyBuffers] = []

    def kept(tables: Tables, sites: Sites) -> ManyBuffers | None:
        found = many_buffers(tables, sites)
        assert found is not None
        made.append(found)
        return found

    monkeypatch.setattr("tactape_fab.sense.decode.search.all_places.many_buffers", kept)
    test_search_is_a_plain_enumeration(name, (0, 3), 0.05)
    assert any(found.known_turns.any() for found in made) == known


@pytest.mark.parametrize(
    ("name", "sector", "corner", "doubt", "at_default", "beyond"),
    [
        thorough("one", 7, (28, 9), 0.02, False, False),
        thorough("mixed", 7, (-2, 3), 0.05, False, False),
        thorough("mixed", 9, (20, 9), 0.02, False, False),
        thorough("mixed", 8, (3, 3), 0.3, False, True),
        ("one", 7, (-2, 3), 0.05, False, True),
        ("one", 104, (-3, 12), 0.02, True, True),
        thorough("mixed", 104, (-3, 12), 0.02, True, True),
        thorough("one", 104, (59, -1), 0.05, True, True),
    ],
)
def test_rivals_are_a_plain_enumeration(
    name: str, sector: int, corner: tuple[int, int], doubt: float, at_default: bool, beyond: bool
) -> None:
    tapes = REGISTRIES[name]
    rng = np.random.default_rng([sector, *(v + 10 for v in corner)])
    origin = None if at_default else tapes[0].origin
    nodes, q = seen(tape_of(sector, origin=origin), corner, 1, rng, dots=22, doubt=doubt)
    world = families(tapes, open_world=True)
    place = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, None)
    assert place is not None
    shown = rivals(world, place, SHARE, beyond=beyond)
    each, sectors = [], []
    default = {tape.sector for tape in tapes if tape.origin == default_origin(tape.code, tape.sector)}
    largest = (max(62, *(tape.columns for tape in tapes)), max(32, *(tape.rows for tape in tapes)))
    for there in sorted({tape.origin for tape in tapes}):
        members = [tape for tape in tapes if tape.origin == there]
        most = (max(t.columns for t in members), max(t.rows for t in members))
        sizes = {largest, *((t.columns, t.rows) for t in tapes)}
        size = min((s for s in sizes if s[0] >= most[0] and s[1] >= most[1]), key=lambda s: s[0] * s[1])
        for other in set(range(256)) - {tape.sector for tape in members}:
            each.append(enumerate_places(tape_of(7, size, there), other, nodes, q))
            sectors.append(other)
    for other in set(range(256)) - default:
        each.append(enumerate_places(tape_of(other, largest), other, nodes, q, overhang=beyond))
        sectors.append(other)
    found, of = joined(each), np.repeat(sectors, [len(here.turn) for here in each])
    score = found.value + np.log(weights_of(found, TURNS)) + np.log(SHARE / (1 - SHARE))
    weight = np.exp(score - place.score - place.weight).sum()
    assert weight * (1 - 0.01) - 1e-6 <= shown.weight <= weight * (1 + 0.01) + 3e-5
    likelihood = found.value + np.log(TURNS[found.turn])
    lead = place.score + np.log(TURNS[place.turn]) - likelihood.max()
    assert shown.lead <= lead + 1e-4
    assert shown.lead >= min(lead, 6.0) - 1e-4
    if lead < 5.0:
        assert shown.name.split()[1] == str(of[int(likelihood.argmax())])
        assert shown.score == pytest.approx(found.value[int(likelihood.argmax())], abs=1e-3)
    if beyond:  # strangers are asked for where they lie, or over an edge at a common origin
        return
    top = int(likelihood.argmax())
    asked = best_unregistered(world, place, SHARE, float(found.value[top]) - 1e-3)
    assert asked.name.split()[1] == str(of[top])
    assert asked.score == pytest.approx(found.value[top], abs=1e-3)
    assert asked.lead == pytest.approx(lead, abs=1e-3)
    assert asked.weight >= np.exp(score - place.score - place.weight)[top] * (1 - 1e-3)


def test_few_tapes_with_holes_have_buffers_for_their_bounds() -> None:
    world = families(REGISTRIES["holes"], open_world=True)[0].registered
    assert isinstance(world, Sites)
    nodes, q = seen(tape_of(7), (28, 9), 0, np.random.default_rng(5), dots=14, doubt=0.02)
    buffers = many_buffers(tables_of(nodes, q, world.signs, 24), world)
    assert buffers is not None
    assert len(buffers.bounds) == len(buffers.of_rows) == len(world.table)
    assert buffers.whole.shape[1] >= 6


def test_a_prior_weighs_half_near_the_last_fix() -> None:
    tapes = REGISTRIES["one"]
    rng = np.random.default_rng(5)
    nodes, q = seen(tapes[0], (28, 9), 0, rng, dots=14, doubt=0.02)
    world = families(tapes, open_world=False)
    plain = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, None)
    assert plain is not None and plain.turn == 0
    k, j = (CENTRE[0] - GRID[2]) / GRID[0], (CENTRE[1] - GRID[3]) / GRID[0]
    centre = (np.array([k, j]) - nodes.min(axis=0) + (28, 9)) * tapes[0].pitch_mm
    prior = Prior(position_mm=(float(centre[0]), float(centre[1])), theta_deg=0.0, radius_mm=2.0)
    near = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, prior)
    assert near is not None
    steps = np.array(list(product(range(-3, 4), range(-3, 4)))) * tapes[0].pitch_mm
    places = (np.hypot(*steps.T) <= 2.0).sum()
    assert near.weight == pytest.approx(np.log(np.exp(plain.weight) * (1 - PRIOR_SHARE) + PRIOR_SHARE / places), abs=1e-6)
    assert near.others < plain.others / 50
    assert near.lead == pytest.approx(plain.lead)  # whatever the prior
    elsewhere = replace(prior, position_mm=(float(centre[0]) + 20.0, float(centre[1])))
    wrong = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, elsewhere)
    assert isinstance(wrong, Place) and (wrong.cells == plain.cells).all()
    assert wrong.weight == pytest.approx(plain.weight + np.log(1 - PRIOR_SHARE))


@pytest.mark.parametrize("open_world", [False, True])
def test_dots_too_far_apart_for_a_tape_have_no_place(open_world: bool) -> None:
    tapes = [tape_of(7, (8, 8))]
    nodes = np.array([(3 * k, k % 2) for k in range(7)])
    q = np.full((7, 4), 0.25)
    assert search(tapes, families(tapes, open_world=open_world), nodes, q, TURNS, GRID, CENTRE, None) is None


def test_two_tapes_at_one_origin_are_no_strangers_to_each_other() -> None:
    tapes = [tape_of(7, origin=(0, 0)), tape_of(8, origin=(0, 0))]
    world = families(tapes, open_world=True)
    nodes, q = seen(tapes[1], (20, 9), 2, np.random.default_rng(3), dots=24, doubt=0.01)
    place = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, None)
    assert place is not None and place.tape == 1
    shown = rivals(world, place, SHARE)
    assert shown.lead > 5.0 and shown.weight < 1e-3


@pytest.mark.parametrize("count", [200, 255])
def test_the_last_strangers_at_an_origin_weigh_what_they_are(count: int) -> None:
    tapes = [tape_of(sector, origin=(0, 0)) for sector in range(count)]
    world = families(tapes, open_world=True)
    nodes, q = seen(tape_of(255, origin=(0, 0)), (10, 7), 1, np.random.default_rng(0), dots=26, doubt=0.05)
    place = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, None)
    assert place is not None
    shown = rivals(world, place, SHARE, beyond=False)
    here = [enumerate_places(tape_of(7, origin=(0, 0)), sector, nodes, q) for sector in range(count, 256)]
    default = set(range(256)) - {0}
    there = [enumerate_places(tape_of(sector), sector, nodes, q, overhang=False) for sector in default]
    found = joined([*here, *there])
    score = found.value + np.log(weights_of(found, TURNS)) + np.log(SHARE / (1 - SHARE))
    assert shown.weight == pytest.approx(np.exp(score - place.score - place.weight).sum(), rel=1e-3)


def test_what_is_left_out_does_not_refuse_what_is_clear() -> None:
    tapes = [tape_of(sector, (20 + sector % 25, 12 + sector // 25)) for sector in range(120)]
    world = families(tapes, open_world=True)
    nodes, q = seen(tapes[40], (2, 2), 1, np.random.default_rng(0), dots=30, doubt=0.002)
    place = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, None, 1e-7)
    assert place is not None and place.tape == 40
    assert place.others <= 1e-7
    assert rivals(world, place, SHARE, 1e-7).weight <= 1e-7


def test_a_prior_does_not_hide_how_near_the_strangers_are() -> None:
    tapes = REGISTRIES["one"]
    world = families(tapes, open_world=True)
    nodes, q = seen(tapes[0], (28, 9), 0, np.random.default_rng(3), dots=14, doubt=0.02)
    place = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, None)
    assert place is not None
    plain = rivals(world, place, SHARE, 1e-12, np.log(30.0))
    sure = rivals(world, replace(place, weight=place.weight + 7.0), SHARE, least_lead=np.log(30.0))
    assert plain.lead > np.log(30.0)
    assert sure.lead > np.log(30.0)


def test_all_sectors_registered_at_one_origin_leave_no_rival_there() -> None:
    tapes = [tape_of(sector, (8, 8), (0, 0)) for sector in range(256)]
    world = families(tapes, open_world=True)[0].unregistered
    assert world is not None
    assert len(world.barred) == 0 and len(world.table) == 255  # sector 0 has its default there
