"""Thresholds of the model linearised at its exact equilibrium, and whether the eigenvalues there confirm them."""

from squeal_rig.model import RigParameters, eigenvalues
from squeal_rig.model.linear.eigen import is_unstable
from squeal_rig.model.linear.maps import map_points


def critical_stiffness_at_rest(p: RigParameters) -> float:
    return float(map_points(p.as_mapping(), at_rest=True).critical_pad_stiffness)


def is_threshold_at_rest(p: RigParameters, k: float, share: float) -> bool:
    """Whether the eigenvalues at the exact equilibrium are stable just below k and unstable just above."""
    below, above = (is_unstable(eigenvalues(p.replace(pad_stiffness=k * (1.0 + side)))) for side in (-share, share))
    return above and not below
