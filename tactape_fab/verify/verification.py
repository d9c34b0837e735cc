"""What a verification found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tactape_fab.base.errors import Check, SpecError, VerifyError

if TYPE_CHECKING:
    from tactape_fab.verify.trip.round_trip import Trip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verification:
    """All lines of a verification, and the contacts of its round trip, by source; none in a quick one."""

    name: str
    checks: tuple[Check, ...]
    trips: tuple[Trip, ...] = ()

    @property
    def passed(self) -> bool:
        return all(c.passed or c.warning for c in self.checks)

    def raise_if_failed(self) -> None:
        """Raise VerifyError with every line where one failed."""
        if not self.passed:
            raise VerifyError(self.checks)


def unreadable(name: str, error: SpecError) -> Verification:
    """The one failed line of a folder whose manifest cannot be read."""
    message = "; ".join(str(error).splitlines())
    return Verification(name=name, checks=(Check(name="manifest", passed=False, message=message),))
