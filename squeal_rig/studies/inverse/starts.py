"""Table 1 of one rig over its start and the length of its record: the two things the paper does not say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from squeal_rig.estimation.calibration.targets import Targets
from squeal_rig.model.linear.eigen import eigenvalues, squeal_frequency
from squeal_rig.model.motion.ensemble import simulate_many
from squeal_rig.model.parameters import RigParameters

#: Starts [static compressions] and records [s] that are tried.
COMPRESSIONS = (1e-6, 1e-3, 0.1, 0.5, 1.0, 2.0)
RECORDS = (5.79, 10.0)


def start_rows(
    p: RigParameters,
    targets: Targets,
    compressions: Sequence[float] = COMPRESSIONS,
    records: Sequence[float] = RECORDS,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> list[dict[str, str]]:
    """Time off the belt [s] and frequency against that at the exact equilibrium, a row a start and a record.

    `pattern` says whether there is no loss at the first stiffness and more the stiffer the pads, `above` whether every
    nonlinear frequency is above the linear one, by any amount.
    """
    items = targets.of("squeal_frequency")
    rigs = [p.replace(preload=t.preload, belt_speed=t.belt_speed, pad_stiffness=t.pad_stiffness) for t in items]
    linear = np.array([squeal_frequency(eigenvalues(rig)) for rig in rigs])
    rows = []
    asked = list(product(compressions, records))
    for done, (start, record) in enumerate(asked, 1):
        motion = simulate_many(rigs, record, initial_compressions=start).summaries
        loss = np.maximum(motion["contact_loss_time"], 0.0)
        ratios = motion["squeal_frequency"] / linear
        rows.append(
            {
                "compressions": f"{start:g}",
                "record_s": f"{record:g}",
                "pattern": _said(loss[0] < 1e-6 and bool(np.all(np.diff(loss) > 0.0))),
                "above": _said(bool(np.all(ratios > 1.0))),
                "loss_s": " ".join(f"{value:.4f}" for value in loss),
                "frequency_ratios": " ".join(f"{value:.5f}" for value in ratios),
                "peak_x_m": " ".join(f"{value:.2e}" for value in motion["peak_x"]),
            }
        )
        progress(done, len(asked))
    return rows


def _said(value: bool) -> str:
    return "yes" if value else "no"
