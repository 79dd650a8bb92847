"""Growth rates measured by the squeal events at unstable points, beside the eigenvalues: python -m benchmarks.growth

Without noise, and with white noise on x as of the data sheets `typical`.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from squeal_rig.estimation.settings import SquealSettings, ToneSettings
from squeal_rig.estimation.squeal_events import SquealEvents
from squeal_rig.model import RigParameters, eigenvalues, simulate
from squeal_rig.model.motion.trajectory import displaced_state

POINTS = [(preload, k) for preload in (100.0, 200.0, 300.0) for k in (3.5e7, 4.5e7, 5.5e7, 6.5e7)]
#: Start off the equilibrium [static compressions], damping [N s/m], noise density [m/sqrt(Hz)].
START, DAMPING, NOISE = 1e-12, 200.0, 1.5e-10
RATE = 51200


def growth(preload: float, k: float, noise: float = 0.0, seed: int = 1) -> tuple[float, float]:
    """Growth [1/s] of the eigenvalue, and measured at the first event that has one; nan where none has."""
    p = RigParameters.preset("yavuz_sen_2023").replace(
        preload=preload, pad_stiffness=k, damping_x=DAMPING, damping_y=DAMPING
    )
    x = simulate(p, 0.6, RATE, displaced_state(p, START)).x
    x = x + np.random.default_rng(seed).normal(0.0, noise * math.sqrt(0.5 * RATE), len(x))
    events = SquealEvents(RATE, SquealSettings(), ToneSettings())
    found = events.add_signal(x) + events.finish()
    rates = [event.growth for event in found if math.isfinite(event.growth.rate)]
    best = min(rates, key=lambda rate: rate.residual, default=None)
    return max(value.real for value in eigenvalues(p)), math.nan if best is None else best.rate


def main() -> None:
    """Print the table."""
    for preload, k in POINTS:
        true, rate = growth(preload, k)
        _, noisy = growth(preload, k, NOISE)
        off, noisy_off = (100.0 * (value / true - 1.0) for value in (rate, noisy))
        sys.stdout.write(
            f"{preload:5.0f} N {k:.2e} N/m {true:9.3f} 1/s, measured {rate:9.3f} ({off:+.4f} %),"
            f" with noise {noisy:9.3f} ({noisy_off:+.2f} %)\n"
        )


if __name__ == "__main__":
    main()
