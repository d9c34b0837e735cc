"""The patch of a press is that of elasticity, and the section on force says what presses showed."""

from __future__ import annotations

from math import inf, pi, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from tactape_fab.sense import Scene
from tests.bench.evidence import force
from tests.bench.evidence.hertz import Gel, compliance, press, punch_depth_mm
from tests.bench.evidence.job import QUICK

INCOMPRESSIBLE = Gel(young_mpa=1.0, poisson=0.5, thickness_mm=4.0)


def by_equations(kh: float, poisson: float) -> float:
    """The same from the equations of equilibrium: a sine wave of pressure on a layer of thickness 1 and modulus E* = 1."""
    young = 1.0 - poisson**2
    shear, lame = young / 2 / (1 + poisson), young * poisson / (1 + poisson) / (1 - 2 * poisson)
    stiff, k = lame + 2 * shear, kh
    # d/dz of (u, w, shear stress, normal stress), from Hooke's law and the balance of forces
    down = np.array([-lame * k / stiff, 0.0, 0.0, 1 / stiff])
    system = np.array([[0.0, k, 1 / shear, 0.0], down, k * (stiff * k * np.eye(4)[0] + lame * down), [0.0, 0.0, -k, 0.0]])
    through = expm(system)[:, 2:]  # no displacement at the base
    stresses = np.linalg.solve(through[2:], [0.0, -1.0])
    return float(-(through[1] @ stresses) * k / 2)


@pytest.mark.parametrize("poisson", [0.2, 0.4, 0.485])
@pytest.mark.parametrize("kh", [0.05, 0.5, 1.0, 2.0, 6.0])
def test_a_layer_gives_way_as_the_equations_say(kh: float, poisson: float) -> None:
    assert compliance(np.array(kh), poisson) == pytest.approx(by_equations(kh, poisson), rel=1e-6)


def test_a_thick_layer_is_a_half_space_and_a_thin_one_a_column() -> None:
    assert compliance(np.array(30.0), 0.485) == pytest.approx(1.0, abs=1e-6)
    thin, poisson = 1e-3, 0.3
    column = (1 + poisson) * (1 - 2 * poisson) / (1 - poisson)  # strain of a clamped column at p = E
    assert 2 * (1 - poisson**2) * compliance(np.array(thin), poisson) / thin == pytest.approx(column, rel=1e-3)
    assert compliance(np.array(thin), 0.5) == pytest.approx(2 * thin**3 / 3, rel=1e-3)  # it cannot give way but sideways


@pytest.mark.parametrize("force_n", [0.1, 0.5, 2.0])
def test_a_ball_sinks_in_as_published(force_n: float) -> None:
    patch = press(force_n, (20.0, 20.0), INCOMPRESSIBLE, half_mm=10.0)
    chi = sqrt(20.0 * patch.depth_mm) / 4.0
    # Garcia and Garcia 2018 (Biophysical Journal, S0006-3495(18)30590-3): a paraboloid on a bonded incompressible layer
    factor = 1 + 1.133 * chi + 1.497 * chi**2 + 1.469 * chi**3 + 0.755 * chi**4
    hertz = 4 / 3 * INCOMPRESSIBLE.plane_mpa * sqrt(20.0) * patch.depth_mm**1.5
    assert force_n / hertz == pytest.approx(factor, rel=0.015)


def test_a_small_patch_on_a_thick_gel_is_hertz_s() -> None:
    gel = Gel(young_mpa=1.0, poisson=0.3, thickness_mm=200.0)
    patch = press(0.5, (10.0, 10.0), gel, half_mm=16.0, cells=192)
    radius = (3 * 0.5 * 10.0 / 4 / gel.plane_mpa) ** (1 / 3)
    assert patch.axes_mm == pytest.approx((2 * radius, 2 * radius), rel=0.03)
    assert patch.pressure_mpa == pytest.approx(0.5 / pi / radius**2, rel=0.06)


def test_patches_follow_the_body_and_end_with_the_face() -> None:
    along = press(1.0, (inf, 15.0), force.GELS["431 kPa"])
    ball = press(1.0, (15.0, 15.0), force.GELS["431 kPa"])
    assert along.axes_mm[0] > 3 * along.axes_mm[1] and along.axes_mm[0] > ball.axes_mm[0] > along.axes_mm[1]
    turned = press(1.0, (15.0, inf), Gel(young_mpa=0.4, poisson=0.48, thickness_mm=4.0, radii_mm=(100.0, 100.0)))
    upright = press(1.0, (inf, 15.0), Gel(young_mpa=0.4, poisson=0.48, thickness_mm=4.0, radii_mm=(100.0, 100.0)))
    assert turned.axes_mm == pytest.approx(upright.axes_mm[::-1])
    small = Gel(young_mpa=0.4, poisson=0.48, thickness_mm=4.0, radii_mm=(100.0, 100.0), face_mm=(8.0, 6.0))
    cut = press(20.0, (inf, inf), small)
    assert cut.pressure_mpa == pytest.approx(20.0 / 48.0, rel=0.06)  # the whole face, to the nearest cell


def test_a_punch_sinks_in_as_far_as_boussinesq_says() -> None:
    assert punch_depth_mm(2.0, pi * 0.25, INCOMPRESSIBLE) == pytest.approx(2.0 / (2 * 0.5 / 0.75))


def test_the_model_meets_the_presses_that_the_material_was_fitted_to() -> None:
    stiff = force.GELS["431 kPa"]
    for depth_mm, force_n in force.PRESSES_N.items():
        modelled = force.force_to(depth_mm, stiff)
        assert press(modelled, force.BALL_MM, stiff).depth_mm == pytest.approx(depth_mm, rel=1e-3)
        assert modelled == pytest.approx(force_n, rel=0.15)


def test_a_light_press_imprints_less() -> None:
    stiff = force.GELS["431 kPa"]
    light, firm = (force.scene_of(press(n, (inf, inf), stiff), stiff) for n in (0.2, 5.0))
    assert 0.03 < light.texture_mm < firm.texture_mm == Scene().texture_mm
    assert light.contact_mm < firm.contact_mm and light.dome_mm < firm.dome_mm


def test_a_press_is_located_where_it_is_firm_enough() -> None:
    firm = force.measure_press("flat block", "431 kPa", 3.0, 4)
    assert (firm["ours right"], firm["ours wrong"], firm["frames"]) == (4, 0, 4)
    assert firm["axes_mm"] == list(press(3.0, (inf, inf), force.GELS["431 kPa"]).axes_mm)
    assert force.measure_press("ball of 20 mm", "431 kPa", 0.05, 4)["ours right"] == 0


def results(enough_n: dict[str, float]) -> dict[str, Any]:
    """Presses that are all located from a force on."""
    found: dict[str, Any] = {
        job.name: {
            "frames": 40,
            **{f"{method} right": 40 if job.options["force_n"] >= enough else 39 for method, enough in enough_n.items()},
            **{f"{method} wrong": 0 for method in enough_n},
            "axes_mm": [12.0, 9.0],
        }
        for job in force.jobs(QUICK)
        if job.name != force.PRESSES
    }
    return found | {force.PRESSES: {gel: dict.fromkeys(("0.5", "1", "1.5", "2"), 1.25) for gel in force.GELS}}


def test_the_section_says_the_least_force() -> None:
    found = results({"ours": 0.3, "paper": 99.0})
    assert force.least_force(found, "flat block", "431 kPa", "ours") == 0.3
    assert "| flat block | 12.0 x 9.0 mm | 12.0 x 9.0 mm | 0.3 N | none | 0.3 N | none |" in force.lines(found)
    assert force.lines(found)[0] == f"## {force.TITLE}"
    assert "| 2 | 23.25 | 1.25 | 1.25 |" in force.lines(found)
    found[force.point("flat block", "431 kPa", 2.0)]["ours right"] = 0
    assert force.least_force(found, "flat block", "431 kPa", "ours") == 3.0
    assert list(force.pictures(found)) == ["evidence-force.png"]
