"""Sobol indices against functions whose indices are known in closed form."""

import math

import numpy as np
import pytest

from squeal_rig.errors import ParameterError
from squeal_rig.experiments.campaign.sensitivity import (
    CRITICAL_STIFFNESS,
    FOLD,
    even_ranges,
    rig_output,
    sobol_indices,
    squeal_probability,
)
from squeal_rig.model import RigParameters, critical_pad_stiffness


def test_indices_of_the_ishigami_function_lie_within_their_confidence():
    """Ishigami and Homma (1990): V1 = (1 + b pi^4/5)^2/2, V2 = a^2/8, V13 = 8 b^2 pi^8/225."""
    a, b = 7.0, 0.1

    def ishigami(x):
        return np.sin(x["x1"]) + a * np.sin(x["x2"]) ** 2 + b * x["x3"] ** 4 * np.sin(x["x1"])

    found = sobol_indices(ishigami, dict.fromkeys(("x1", "x2", "x3"), (-math.pi, math.pi)), 1024)
    v1, v2, v13 = 0.5 * (1.0 + b * math.pi**4 / 5.0) ** 2, a**2 / 8.0, 8.0 * b**2 * math.pi**8 / 225.0
    total = v1 + v2 + v13
    first, whole = np.array([v1, v2, 0.0]) / total, np.array([v1 + v13, v2, v13]) / total
    assert np.all(np.abs(found.first - first) <= found.first_confidence)
    assert np.all(np.abs(found.total - whole) <= found.total_confidence)
    assert found.std**2 == pytest.approx(total, rel=0.02)


def test_indices_of_k_cr_at_small_scatter_are_those_of_its_derivatives():
    """A function that is linear over the scatter: S_i = (df/dx_i w_i)^2 over their sum, w_i the range's width."""
    p = RigParameters.preset("yavuz_sen_2023")
    ranges = {n: (getattr(p, n) * 0.999, getattr(p, n) * 1.001) for n in ("contact_stiffness", "k3", "mu0", "preload")}
    slopes = []
    for name, (low, high) in ranges.items():
        ends = [critical_pad_stiffness(p.replace(**{name: value})) for value in (low, high)]
        slopes.append(ends[1] - ends[0])
    expected = np.square(slopes) / np.sum(np.square(slopes))
    found = sobol_indices(rig_output(p, CRITICAL_STIFFNESS), ranges, 1024)
    assert np.all(np.abs(found.first - expected) <= found.first_confidence + 2e-3)
    assert np.all(np.abs(found.total - expected) <= found.total_confidence + 2e-3)
    assert found.left_out == 0.0


def test_probability_of_squeal_is_half_at_the_threshold_and_certain_far_beyond():
    p = RigParameters.preset("yavuz_sen_2023")
    at = p.replace(pad_stiffness=critical_pad_stiffness(p))
    share, error = squeal_probability(at, {"mu0": 0.01, "mass": 0.01})
    assert abs(share - 0.5) < 4.0 * error
    assert squeal_probability(p.replace(preload=300.0, pad_stiffness=6e7), {"mu0": 0.01})[0] == 1.0
    with pytest.raises(ParameterError, match="at most"):
        squeal_probability(p, {"mu0": 0.5})
    with pytest.raises(ParameterError, match="power of two"):
        sobol_indices(lambda x: x["a"], {"a": (0.0, 1.0)}, 100)


def test_what_does_not_vary_has_no_indices():
    p = RigParameters.preset("yavuz_sen_2023").replace(damping_x=20.0, damping_y=20.0)
    ranges = even_ranges(p, {"mu0": 0.05, "mu_preload": 0.02})
    assert ranges["mu0"] == pytest.approx((p.mu0 * (1.0 - 0.05 * 3**0.5), p.mu0 * (1.0 + 0.05 * 3**0.5)))
    with pytest.raises(ParameterError, match="whatever mu0, mu_preload"):
        sobol_indices(rig_output(p, FOLD), ranges, 8)
