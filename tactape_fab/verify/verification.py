"""Result of a verification."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tactape_fab.base.errors import Check, SpecError, VerifyError

if TYPE_CHECKING:
    from tactape_fab.verify.trip.round_trip import Trip

OnCheck = Callable[[Check], None]
"""Called with every line as soon as it is known."""
Beside = Callable[[], Iterable[Check]]
"""Further checks of the same files, run while other programs read the models."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verification:
    """All lines of a verification.

    Attributes
    ----------
    name : str
        Name of the kit or panel.
    checks : tuple of Check
        Every line, in order.
    trips : tuple of Trip
        Contacts of the full round trip, by source; empty for a quick verification.
    """

    name: str
    checks: tuple[Check, ...]
    trips: tuple[Trip, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every line holds, warnings excepted."""
        return all(c.passed or c.warning for c in self.checks)

    def raise_if_failed(self) -> None:
        """Raise an error if a line failed.

        Raises
        ------
        VerifyError
            With every line.
        """
        if not self.passed:
            raise VerifyError(self.checks)


def collected(name: str, lines: Iterable[Check], on_check: OnCheck, trips: Sequence[Trip] = ()) -> Verification:
    """Collect lines into a verification, reporting each as it comes; `trips` may grow meanwhile."""
    checks = []
    for line in lines:
        checks.append(line)
        on_check(line)
    return Verification(name=name, checks=tuple(checks), trips=tuple(trips))


def unreadable(name: str, error: SpecError, on_check: OnCheck) -> Verification:
    """Verification with the single failed line that the manifest cannot be read."""
    message = "; ".join(str(error).splitlines())
    return collected(name, [Check(name="manifest", passed=False, message=message)], on_check)
