"""A calibration in plain values."""

from __future__ import annotations

from math import inf, nan
from types import SimpleNamespace

import numpy as np

from tactape_fab.sense.calibrate.result import HeldOut, Quantity
from tests.unit.sense.calibrate.by_hand import calibration


def test_an_answer_in_json_has_null_where_a_figure_is_not_known() -> None:
    valid = np.array([[True, True], [True, False]])
    quantities = tuple(Quantity("q" + str(k), 1.5, sigma, "mm", "n") for k, sigma in enumerate((0.1, None, inf, nan)))
    said = calibration(quantities=quantities, valid=valid, held_out=HeldOut(inside_um=1.0, outside_um=2.0, folds=4)).to_mapping()
    assert [of["sigma"] for of in said["quantities"].values()] == [0.1, None, None, None]
    assert said["quantities"]["q0"] == {"value": 1.5, "sigma": 0.1, "unit": "mm", "note": "n"}
    assert (said["sensor"], said["frames"], said["presses"], said["dots"]) == ("mine", 5, [3, 4], 5)
    assert said["orientation"] == {"sign": -1, "mirror": True, "rotate90": 3}
    assert said["held_out"] == {"inside_um": 1.0, "outside_um": 2.0, "folds": 4}
    assert (said["valid_share"], said["hand_eye"], said["remarks"]) == (0.75, None, ["press more often"])
    rest = calibration(hand_eye=SimpleNamespace(to_mapping=lambda: {"tape": "t"})).to_mapping()
    assert (rest["valid_share"], rest["held_out"], rest["hand_eye"]) == (1.0, None, {"tape": "t"})
