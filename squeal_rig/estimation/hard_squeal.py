"""What the eigenvalues do not say of a set point, as a status: zone, both borders, squeal to expect, hits it bears.

Source: `model.cycles`. It takes longer than a callback may: a node has it computed in a process beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from squeal_rig.errors import ModelError
from squeal_rig.estimation.spectra import level_db
from squeal_rig.model.parameters import RigParameters
from squeal_rig.recording.cdr import text_of

Status = tuple[int, str, str, Mapping[str, str]]  # level, name, message, values

NAME = "stability: hard squeal"
#: Key that tells how far it is: one of the three below.
STATE_KEY = "hard squeal"
COMPUTED, COMPUTING, UNAVAILABLE = "computed", "being computed", "not available"
ZONE, SMALLEST_HIT, HIT_DIRECTION = "zone", "smallest hit [N s]", "smallest hit direction [rad]"
_OK, _WARN = 0, 1  # levels of diagnostic_msgs/DiagnosticStatus


def pending() -> Status:
    """The status while it is being computed."""
    return _OK, NAME, COMPUTING, {STATE_KEY: COMPUTING}


def unavailable(sentence: str) -> Status:
    """The status of a set point that has no zone, or whose zone could not be computed."""
    return _OK, NAME, f"{UNAVAILABLE}: {sentence}", {STATE_KEY: UNAVAILABLE}


@lru_cache(maxsize=256)  # a run comes back to its operating points
def hard_squeal(p: RigParameters) -> Status:
    """Compute the status of a set point; "not available" with the reason where there is none."""
    # Here and not above: a node that turned it off does not load it.
    from squeal_rig.model.cycles.hits import smallest_hit
    from squeal_rig.model.cycles.safe import safe_hit
    from squeal_rig.model.cycles.zones import BISTABLE, SQUEAL, located

    try:
        found = located(p)
        zone = found.zone
        hit = smallest_hit(p, known=found) if zone.name == BISTABLE else None
        safe = safe_hit(p)
    except ModelError as error:
        return unavailable(str(error))
    squeal = zone.squeal
    seen = squeal is not None and squeal.found
    smallest = 0.0 if zone.name == SQUEAL else math.nan if hit is None else hit.impulse
    direction = math.nan if hit is None else hit.direction
    values: dict[str, object] = {
        STATE_KEY: COMPUTED,
        ZONE: zone.name,
        "mu beyond fold": zone.to_fold_mu,
        "mu beyond flutter": zone.to_flutter_mu,
        "k beyond fold [N/m]": zone.to_fold_pad_stiffness,
        "k beyond flutter [N/m]": zone.to_flutter_pad_stiffness,
        "cycle frequency [Hz]": squeal.frequency if squeal is not None and seen else math.nan,
        "cycle level [dB re 1 um]": _level(squeal.states[:, 0]) if squeal is not None and seen else math.nan,
        SMALLEST_HIT: smallest,
        HIT_DIRECTION: direction,
        "safe hit [N s]": safe,
        "notes": "; ".join(zone.reasons),
    }
    text = {key: text_of(value) for key, value in values.items()}
    return _OK if zone.name not in (BISTABLE, SQUEAL) else _WARN, NAME, _sentence(zone.name, smallest), text


def _level(x: np.ndarray) -> float:
    """Level [dB re 1 um] of x (n,) [m] over one period, as the squeal detector measures it."""
    return level_db(float(np.std(x)))


def _sentence(zone: str, smallest: float) -> str:
    if zone == "bistable":
        bears = (
            f"a hit of {smallest:.3g} N s starts squeal" if math.isfinite(smallest) else "no hit tried starts squeal"
        )
        return f"bistable: quiet until hit, {bears}"
    return "squeal: by itself" if zone == "squeal" else "quiet: no hit starts squeal that lasts"
