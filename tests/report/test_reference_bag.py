"""The reference bag that ships: what was recorded once is read, and estimated again to the same numbers."""

from pathlib import Path

import numpy as np
import pytest

from squeal_rig.analysis.estimate import estimate_bag
from squeal_rig.analysis.segments import analyse_bag
from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.recording.verify import verify

REFERENCE = Path(__file__).parents[2] / "bags" / "reference"


def windows(bag: Path) -> np.ndarray:
    return np.concatenate([samples_from_cdr(m.data).samples for m in Bag(bag).messages(["/friction/windows"])])


def test_it_is_sound_and_small():
    assert verify(REFERENCE).sound
    assert sum(file.stat().st_size for file in REFERENCE.iterdir()) < 2e6


def test_todays_estimator_gives_the_recorded_windows(tmp_path):
    estimate_bag(REFERENCE, tmp_path / "again")
    recorded, again = windows(REFERENCE), windows(tmp_path / "again")
    assert len(recorded) == len(again) == 6
    for name in recorded.dtype.names:
        # Sums of floats may round differently on another kind of processor.
        assert again[name] == pytest.approx(recorded[name], rel=1e-9, nan_ok=True)


def test_it_squeals_below_the_linear_frequency():
    analysis = analyse_bag(REFERENCE)
    assert analysis.lost_samples == 0
    squeal = analysis.segments[-1]
    assert squeal.squealing
    assert 950.0 < squeal.squeal_frequency() < 1100.0  # still on its way to the limit cycle's 974 Hz
    assert squeal.stability.squeal_frequency == pytest.approx(1174.0, abs=1.0)
