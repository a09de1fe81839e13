"""The second engine: bodies are where the first one has them, and the shipped gait walks there, too."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")
DEPLOY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(DEPLOY / "python" / "examples"))

from second_engine import place, spearman, trial  # noqa: E402

QUAD = json.loads((DEPLOY / "structures" / "quad5-sym.json").read_text())


def test_the_flat_quadruped_lies_on_the_floor() -> None:
    placed = place(QUAD, "-y")
    assert np.allclose([half[2, 3] for half in placed.halves], 0.055)
    # Cubes of one module touch, and limbs are in neighbouring cells.
    centres = {tuple(np.round(half[:2, 3] / 0.055).astype(int)) for half in placed.halves}
    assert len(centres) == 10


def test_the_shipped_gait_walks() -> None:
    best = json.loads((DEPLOY / "gaits" / "quad5.json").read_text())["best"]
    outcome = trial(place(QUAD, "-y"), best["joints"], 15.0, 0.8)
    assert not outcome.collided
    assert outcome.speed >= 0.5 * best["fitness_mm_s"]
    assert 0.1 < outcome.cost < 100.0


def test_ranks_correlate() -> None:
    assert spearman([1.0, 2.0, 3.0], [10.0, 30.0, 90.0]) == pytest.approx(1.0)
    assert spearman([1.0, 2.0, 3.0], [9.0, 5.0, 1.0]) == pytest.approx(-1.0)
