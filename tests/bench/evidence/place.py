"""p_place said against places that were wrong, by decade: `tests.bench.place_chance` at full size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tests.bench.evidence.job import Job, Result, Size
from tests.bench.place_chance import Decade, batches, by_decade, measure, rows, scenes

SECTION = "p_place"
TITLE = "Is p_place true?"
CONTACTS = {"full": 100_000, "quick": 2_000}
TOGETHER = 10
"""Batches of one job."""


def jobs(size: Size) -> list[Job]:
    """Contacts of every scene, some batches at a time."""
    parts = -(-CONTACTS.get(size.name, 80) // (len(scenes(False, {})) * 250))
    return [
        Job(
            section=SECTION,
            name=f"{name}, from {first}",
            measure=measure_batches,
            options={"name": name, "first": first, "last": min(first + TOGETHER, parts)},
        )
        for name in scenes(False, {})
        for first in range(0, parts, TOGETHER)
    ]


def measure_batches(name: str, first: int, last: int) -> Result:
    """Decades of the batches of a scene, from `first` to before `last`."""
    count = 250 * len(scenes(False, {})) * last
    chosen = [one for one in batches(False, {}, count) if one.name == name and first <= one.part < last]
    found: list[Any] = []
    for batch in chosen:
        found += measure(batch)
    return {"contacts": sum(batch.count for batch in chosen), "decades": [list(one) for one in by_decade(found)]}


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    contacts = sum(one["contacts"] for one in results.values())
    decades = [Decade(*values) for one in results.values() for values in one["decades"]]
    return [
        f"## {TITLE}",
        "",
        f"{contacts:,} contacts of 4.5 to 6 mm, with all parts and with 30 % of them missing, among 1 and among 16 tapes that",
        "are all known to the decoder (closed world), each asked for with both `--max-p-tape` and with no other limit: so few",
        "dots are seen that places are mistaken. Of the answers that say such a p_place: how many wrong ones that adds up to,",
        "and how many there were. The default limits refuse all above 1e-4. Where happened / said is below 1, p_place is on the",
        "safe side; the range is that of 95 %.",
        "",
        *rows(decades),
        "",
    ]
