"""Input of `advise` (contact, sensor, fab or process), read from untrusted values with all problems reported together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tactape_fab.advise.designs import FILM
from tactape_fab.base.errors import Problem, SpecError, tried
from tactape_fab.base.fields import Fields, unknown_key
from tactape_fab.base.templates import DEFAULT_SENSOR, profile_names
from tactape_fab.kit.profiles import FabProfile, ProcessProfile, load_fab, load_process
from tactape_fab.kit.spec.grid_options import DEFAULT_SIZE_MM
from tactape_fab.kit.spec.options import DEFAULT_FAB
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.sense.geometry import USUAL_BLUR_MM
from tactape_fab.sense.sensors import SensorProfile, load_sensor
from tactape_fab.sense.simulation.scene import Scene, blur_of

KEYS = ("contact_mm", "sensor", "process", "fab", "blur_mm", "placement_mm", "tapes", "size_mm")
MOST_CONTACT_MM, MOST_BLUR_MM, MOST_PLACEMENT_MM, MOST_TAPES = 100.0, 0.5, 0.2, 1000
_DEFAULTS = {"blur_mm": USUAL_BLUR_MM, "placement_mm": Scene().placement_mm, "tapes": 1, "process": FILM}


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """The contacts to be located, and the process that makes the tape.

    contact_mm: Diameter of the smallest contact to be located.
    profile: Name or path of the fab or process profile as given, for a spec and a command line.
    blur_mm, placement_mm: Standard deviations of the gel's smoothing, and of the parts' places along each axis.
    tapes: Number of registered tapes.
    size_mm: Outline of a tape.
    """

    contact_mm: float
    sensor: SensorProfile
    making: FabProfile | ProcessProfile
    profile: str
    blur_mm: float
    placement_mm: float
    tapes: int
    size_mm: tuple[float, float]

    @property
    def field_mm(self) -> float:
        """The shorter side of the sensor's field, mm."""
        return min(self.sensor.width_px / self.sensor.px_per_mm[0], self.sensor.height_px / self.sensor.px_per_mm[1])


def read_question(values: Mapping[str, Any]) -> Question:
    """Read a question from untrusted values; missing keys have their defaults. Raises SpecError: every problem found."""
    problems: list[Problem] = []
    sensor = tried(lambda: load_sensor(values.get("sensor", DEFAULT_SENSOR)), problems)
    blur = {} if sensor is None else {"blur_mm": blur_of(Scene(), sensor.gel)}
    table = Fields({**_DEFAULTS, **blur, **values}, "", problems)
    problems += [unknown_key(key, KEYS) for key in values if key not in KEYS]
    if "contact_mm" not in values:
        table.problem("contact_mm", "contact is missing; give --contact MM, such as 6")
    contact_mm = Fields({"contact_mm": 1.0, **values}, "", problems).number(
        "contact_mm", low=1.0, high=MOST_CONTACT_MM, remedy="give --contact MM, such as 6"
    )
    blur_mm = table.number(
        "blur_mm", low=0.0, high=MOST_BLUR_MM, remedy=f"give --blur from 0 to {MOST_BLUR_MM:g} mm; it counts before the sensor's"
    )
    placement_mm = table.number("placement_mm", low=0.0, high=MOST_PLACEMENT_MM)
    tapes = table.integer("tapes", low=1, high=MOST_TAPES)
    processes = (FILM, *profile_names("processes"))
    process = table.text("process", choices=processes)
    outline: Any = values.get("size_mm", DEFAULT_SIZE_MM)  # checked as in `make`
    size_mm = tried(lambda: TapeSpec(sector=0, size_mm=outline).size_mm, problems)
    known = process in processes  # otherwise it is already refused
    if known and process != FILM and "fab" in values:
        message = (
            f"fab = {values['fab']!r} contradicts process = '{process}': a fab makes films; use --process {FILM}, or no --fab"
        )
        problems.append(Problem("fab", message))
    fab = values.get("fab", DEFAULT_FAB)  # also read if the process is refused
    making = tried(lambda: load_process(process) if known and process != FILM else load_fab(fab), problems)
    if problems or sensor is None or making is None or size_mm is None:
        raise SpecError(problems)
    return Question(
        contact_mm=contact_mm,
        sensor=sensor,
        making=making,
        profile=str(fab) if process == FILM else process,
        blur_mm=blur_mm,
        placement_mm=placement_mm,
        tapes=tapes,
        size_mm=size_mm,
    )
