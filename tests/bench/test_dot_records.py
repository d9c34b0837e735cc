"""Dots drawn from records against dots found in depth maps: what false accepts are counted on looks like what a sensor shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.stats import ks_2samp

from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.dots.detect import detect
from tactape_fab.texture.frames import FloatArray
from tests.bench.dot_records import PX_PER_MM, Edge, contact_poses, recorded
from tests.bench.localization_false import SCENES
from tests.bench.localization_measure import localizer_of
from tests.bench.localization_rows import SEED, registered_tape
from tests.bench.measure import run
from tests.bench.recorded import draw_dots

FRAMES = 250
MATCH_PX = 7.0
IMPRINTS = ((0.2, 0.5), (0.5, 0.8), (0.8, 0.999), (0.999, 1.1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """What frames look like: dots a frame, false ones among them, weights, errors px by imprint, log10 p_tape."""

    counts: FloatArray
    false_counts: FloatArray
    weights: FloatArray
    errors_px: list[FloatArray]
    found: FloatArray
    p_tape: FloatArray


def look_of(scene: Scene, edge: Edge, *, depth: bool) -> Look:
    """Frames of the registered tape at the same poses, through depth maps or drawn."""
    tape = registered_tape()
    poses = contact_poses(tape, FRAMES, SEED + 901, scene, edge)
    frames = list(iterate_frames(tape, FRAMES, SEED + 901, scene=scene, poses=poses))
    if depth:
        found = [detect(frame.depth, PX_PER_MM) for frame in frames]
        dots = [(one.xy_px, one.weights) for one in found]
    else:
        drawn = draw_dots(tape, poses, recorded(scene, edge), np.random.default_rng(SEED))
        dots = [(one.xy_px, one.weights) for one in map(drawn.__getitem__, range(FRAMES))]
    localizer = localizer_of(1, "closed")
    nearest = []
    false_counts = []
    for frame, (xy, _) in zip(frames, dots, strict=True):
        apart = np.hypot(*(frame.dots_px[:, None] - xy[None]).transpose(2, 0, 1))
        nearest.append(np.column_stack([frame.dots_imprint, apart.min(axis=1, initial=99.0)]))
        false_counts.append((apart.min(axis=0, initial=99.0) > MATCH_PX).sum())
    part = np.concatenate(nearest)
    here = [(part[:, 0] >= low) & (part[:, 0] < high) for low, high in IMPRINTS]
    fixes = [localizer.locate_dots(xy, weights) for xy, weights in dots]
    return Look(
        counts=np.array([len(weights) for _, weights in dots], dtype=np.float64),
        false_counts=np.array(false_counts, dtype=np.float64),
        weights=np.concatenate([weights for _, weights in dots]),
        errors_px=[part[which & (part[:, 1] < MATCH_PX), 1] for which in here],
        found=np.array([(part[which, 1] < MATCH_PX).mean() for which in here]),
        p_tape=np.log10([1.0 if fix.p_tape is None else max(fix.p_tape, 1e-99) for fix in fixes]),
    )


@pytest.mark.parametrize("contact", SCENES)
def test_drawn_dots_look_like_detected_ones(contact: str, benchmark: BenchmarkFixture) -> None:
    """In everything that an answer rests on, and in what the bound makes of them."""
    scene, edge = SCENES[contact]
    real = look_of(scene, edge, depth=True)
    drawn = run(benchmark, lambda: look_of(scene, edge, depth=False), rounds=1)
    assert drawn.counts.mean() == pytest.approx(real.counts.mean(), rel=0.02)
    assert drawn.counts.std() == pytest.approx(real.counts.std(), rel=0.3)
    assert drawn.false_counts.mean() == pytest.approx(real.false_counts.mean(), abs=0.3, rel=0.1)
    assert drawn.found == pytest.approx(real.found, abs=0.08)
    assert ks_2samp(real.weights, drawn.weights).statistic < 0.03
    for k, (real_px, drawn_px) in enumerate(zip(real.errors_px, drawn.errors_px, strict=True)):
        share = [0.25, 0.5, 0.75] if k < len(IMPRINTS) - 1 else [0.25, 0.5, 0.75, 0.95]
        rel = 0.2 if k < len(IMPRINTS) - 1 else 0.08  # few dots stand at the rim
        assert np.quantile(drawn_px, share) == pytest.approx(np.quantile(real_px, share), rel=rel), f"imprint {IMPRINTS[k]}"
    assert ks_2samp(real.p_tape, drawn.p_tape).statistic < 0.17
    assert np.median(drawn.p_tape) == pytest.approx(np.median(real.p_tape), abs=0.7)
