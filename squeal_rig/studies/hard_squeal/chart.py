"""The three zones over preload and belt speed, with the smallest hit of each point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ParameterError
from squeal_rig.model.core.law import friction_coefficient, friction_refusal
from squeal_rig.model.cycles.zone_map import ZoneMap, zone_map
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]

PRELOADS, SPEEDS = (10.0, 300.0), (1.0, 4.0)
_POINTS = 200


@dataclass(frozen=True)
class Chart:
    """Zones over preloads (n,) [N] and belt speeds (m,) [m/s]; arrays of the map are (m, n)."""

    rig: RigParameters
    preloads: Values
    speeds: Values
    map: ZoneMap

    def share(self, code: int) -> float:
        """Share of the points in a zone."""
        return float(np.mean(self.map.zone == code))


def zone_chart(
    p: RigParameters,
    preloads: tuple[float, float] = PRELOADS,
    speeds: tuple[float, float] = SPEEDS,
    points: int = _POINTS,
) -> Chart:
    """Zones and smallest hits over ranges of preload [N] and belt speed [m/s], `points` values of each.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping).
        ParameterError: a range is out of bounds, or the friction law gives a negative coefficient in it.
    """
    f, v = np.linspace(*preloads, points), np.linspace(*speeds, points)
    # The law is linear in both: it is smallest in a corner.
    corners = [p.replace(preload=force, belt_speed=speed) for force in preloads for speed in speeds]
    refusal = friction_refusal(min(corners, key=friction_coefficient))
    if refusal:
        raise ParameterError(refusal)
    return Chart(p, f, v, zone_map(p, hits=True, preload=f[None, :], belt_speed=v[:, None]))
