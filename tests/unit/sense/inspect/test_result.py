"""What an inspection says of parts: each deviation once, with value, limit and unit, and its file without places of none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense.inspect.result import Deviation, Inspection, ScanFacts
from tests.tapes import tape_at

TAPE = tape_at(7, (4, 3))
SITES = [(float(x), float(y)) for x, y in TAPE.part_xy_mm()]
NONE = np.zeros(12, dtype=bool)
SCAN = ScanFacts(
    name="a.png",
    dpi=1200.0,
    px_per_mm=(47.2441234, 47.25),
    shear=1.23456789e-4,
    jitter_um=1.234,
    film_sigma_um=2.345,
    found_by="tag",
)


def inspection() -> Inspection:
    """R2 is missing, R3 stands, R4 is off, R5 turned, R6 covered and off, R7 off and turned; something lies between them."""
    shift, turn, at = np.zeros((12, 2)), np.zeros(12), np.arange(1, 13)
    shift[[1, 3, 5, 6]] = (0.5, 0.0), (0.12, -0.161), (0.5, 0.0), (-0.3, 0.4)
    shift[7] = 0.2, 0.0
    turn[[1, 4, 5, 6, 7]] = 40.0, -10.1, 50.0, 12.0, 10.0
    return Inspection(
        tape=TAPE,
        manifest_sha256="0" * 64,
        shift_mm=shift,
        turn_deg=turn,
        sigma_mm=np.arange(12) / 1000,
        present=~np.isin(at, (2, 3)),
        tombstoned=at == 3,
        covered=at == 6,
        foreign_mm=np.array([(1.0, 2.0, 0.3)]),
        tolerance_mm=0.2,
        turn_tolerance_deg=10.0,
        scans=(SCAN,),
    )


def test_deviations_are_those_beyond_the_tolerances() -> None:
    off = (0.12**2 + 0.161**2) ** 0.5
    assert inspection().deviations() == [
        Deviation(kind="missing", designator="R2", at_mm=SITES[1]),
        Deviation(kind="tombstoned", designator="R3", at_mm=SITES[2]),
        Deviation(kind="shifted", designator="R4", at_mm=SITES[3], value=pytest.approx(off), limit=0.2, unit="mm"),  # type: ignore[arg-type]
        Deviation(kind="turned", designator="R5", at_mm=SITES[4], value=-10.1, limit=10.0, unit="deg"),
        Deviation(kind="foreign", designator="R6", at_mm=SITES[5]),
        Deviation(kind="shifted", designator="R7", at_mm=SITES[6], value=0.5, limit=0.2, unit="mm"),
        Deviation(kind="turned", designator="R7", at_mm=SITES[6], value=12.0, limit=10.0, unit="deg"),
        Deviation(kind="foreign", designator="", at_mm=(1.0, 2.0), value=0.3, unit="mm"),
    ]


def test_mean_and_scatter_are_of_the_parts_that_are_there() -> None:
    found = inspection()
    x = np.array([0.12, 0.5, -0.3, 0.2, 0, 0, 0, 0, 0, 0])
    assert found.mean_shift_mm == pytest.approx((0.052, 0.0239))
    assert found.scatter_mm[0] == pytest.approx(np.sqrt((x**2).mean() - x.mean() ** 2))
    none = replace(found, present=NONE)
    assert none.mean_shift_mm == none.scatter_mm == (0.0, 0.0)


def test_the_file_has_no_place_of_a_part_that_is_missing() -> None:
    found, built = inspection(), inspection().as_built()
    assert (built.tape, built.manifest_sha256, built.number.tolist()) == (TAPE.name, "0" * 64, list(range(1, 13)))
    assert built.present.tolist() == found.present.tolist() and built.sigma_mm.tolist() == found.sigma_mm.tolist()
    assert (built.dx_mm[[1, 3]].tolist(), built.dy_mm[[1, 3]].tolist()) == ([0.0, 0.12], [0.0, -0.161])
    assert built.rotation_deg[[1, 4]].tolist() == [0.0, -10.1]
    assert (built.film.scale, built.film.shear, built.film.sigma) == ((1.0, 1.0), 0.0, 0.001)
    assert built.source == (
        {
            **{"kind": "scan", "file": "a.png", "dpi": 1200.0, "px_per_mm": [47.24412, 47.25], "shear": 0.000123},
            **{"jitter_um": 1.23, "lands_um": 2.35, "found_by": "tag", "drift_mm": 0.001},
        },
    )


def test_the_summary_is_rounded_and_a_photograph_says_so() -> None:
    photo = replace(SCAN, dpi=None, growth=0.00123456, common_mm=0.0024)
    said = replace(inspection(), scans=(photo,)).to_mapping()
    assert (said["tape"], said["parts"], said["present"], said["sigma_mm"]) == (TAPE.name, 12, 10, 0.0055)
    assert (said["mean_shift_mm"], said["scatter_mm"][0]) == ([0.052, 0.0239], 0.191666)
    assert (said["tolerance_mm"], said["turn_tolerance_deg"]) == (0.2, 10.0)
    (scan,) = said["scans"]
    # 1 um of every scan, and the photograph's own
    assert (scan["photo"], scan["parallax_per_mm"], scan["drift_mm"]) == (True, 0.001235, 0.0026)
    assert said["deviations"][2] == {
        **{"kind": "shifted", "designator": "R4", "at_mm": [round(v, 4) for v in SITES[3]]},
        **{"value": 0.2008, "limit": 0.2, "unit": "mm"},
    }
    assert said["deviations"][-1]["designator"] is None and said["deviations"][0]["value"] is None
