"""Result of a verification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tactape_fab.base.errors import Check, SpecError, VerifyError

if TYPE_CHECKING:
    from tactape_fab.verify.trip.round_trip import Trip


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
        Contacts of the round trip, by source; none in a quick verification.
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


def unreadable(name: str, error: SpecError) -> Verification:
    """Verification with one failed line: the manifest cannot be read."""
    message = "; ".join(str(error).splitlines())
    return Verification(name=name, checks=(Check(name="manifest", passed=False, message=message),))
