"""Tapes whose parts stand somewhere else than the design has them, with what a measurement of some accuracy says of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactape_fab import AsBuilt, Tape
from tactape_fab.sense import Parts

ANY_DIGEST = "0" * 64


def measured(
    tape: Tape,
    placement_mm: float,
    *,
    missing: float = 0.0,
    error_mm: float = 0.003,
    seed: int = 0,
    digest: str = ANY_DIGEST,
) -> tuple[Tape, Parts]:
    """The tape with measured places, and the parts that are really there."""
    rng = np.random.default_rng(seed)
    n = tape.part_count
    shift, error = rng.normal(0.0, placement_mm, (n, 2)), rng.normal(0.0, error_mm, (n, 2))
    present = rng.random(n) >= missing
    dx, dy = (np.where(present, column, 0.0) for column in (shift + error).T)
    built = AsBuilt(
        tape=tape.name,
        manifest_sha256=digest,
        number=np.arange(1, n + 1),
        dx_mm=dx,
        dy_mm=dy,
        rotation_deg=np.zeros(n),
        present=present,
        sigma_mm=np.full(n, error_mm),
        source=({"kind": "scan"},),
    )
    parts = Parts(xy_mm=tape.part_xy_mm() + shift, rotation_deg=np.full(n, tape.part.rotation_deg))
    return replace(tape, as_built=built), parts.taken(present)
