"""Sobol indices: which parameter the scatter of k_cr, of the fold or of the squeal frequency comes from.

Sampling and estimates are SALib's (Saltelli et al., Comput. Phys. Commun. 181, 2010; Jansen's total index).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ExperimentError, ParameterError
from squeal_rig.experiments.campaign.plans import MOST_SCATTER, PAD_STIFFNESS
from squeal_rig.experiments.campaign.store import NO_EXTRA
from squeal_rig.model.cycles.zone_map import zone_map
from squeal_rig.model.linear.maps import stability_map
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]

CRITICAL_STIFFNESS, FOLD, FREQUENCY = "k_cr [N/m]", "fold [mu]", "squeal frequency [Hz]"
#: Outputs of a rig, and how many samples each is worth: a fold takes some 80 ms for each machine.
OUTPUTS = {CRITICAL_STIFFNESS: 1024, FREQUENCY: 1024, FOLD: 32}
_MOST_SAMPLES = 1 << 16


@dataclass(frozen=True)
class SobolIndices:
    """First-order and total index of each parameter, with the half width of their confidence interval.

    mean, std: of the output over the scatter; `left_out`: samples where it does not exist, as a share.
    """

    names: tuple[str, ...]
    first: Values
    first_confidence: Values
    total: Values
    total_confidence: Values
    mean: float
    std: float
    left_out: float


def sobol_indices(
    function: Callable[[dict[str, Any]], Values],
    ranges: Mapping[str, tuple[float, float]],
    samples: int = 1024,
    confidence: float = 0.95,
    seed: int = 1,
) -> SobolIndices:
    """Sobol indices of a function of parameters that are spread evenly over ranges and do not depend on each other.

    Args:
        function: takes name -> values (n,), returns (n,); where it does not exist, nan, which the mean stands in for.
        ranges: name -> low, high.
        samples: a power of two; the function is called on samples times (parameters + 2).
        confidence: of the intervals, by SALib's bootstrap.

    Raises:
        ParameterError: an argument is out of its bounds, or the function is constant, or nowhere at most samples.
        ExperimentError: SALib is missing.
    """
    if not 2 <= samples <= _MOST_SAMPLES or samples & (samples - 1):
        raise ParameterError(f"samples = {samples} is out of bounds: it must be a power of two, 2 to {_MOST_SAMPLES}")
    for name, (low, high) in ranges.items():
        if not low < high:
            raise ParameterError(f"the range of {name} is empty: {low:g} to {high:g}")
    try:
        from SALib.analyze import sobol as analysis
        from SALib.sample import sobol as sampling
    except ImportError:
        raise ExperimentError(NO_EXTRA) from None
    problem: dict[str, Any] = {
        "num_vars": len(ranges), "names": list(ranges), "bounds": [list(ends) for ends in ranges.values()]
    }  # fmt: skip
    table = np.asarray(sampling.sample(problem, samples, calc_second_order=False, seed=seed))
    output = np.asarray(function({name: table[:, i] for i, name in enumerate(ranges)}), dtype=np.float64)
    missing = ~np.isfinite(output)
    if missing.mean() > 0.5:
        raise ParameterError(f"the output does not exist at {100.0 * missing.mean():.0f} % of the samples: no indices")
    mean, std = float(output[~missing].mean()), float(output[~missing].std())
    if not std > 1e-12 * abs(mean):
        raise ParameterError(f"the output is {mean:g} whatever {', '.join(ranges)}: no indices")
    output[missing] = mean
    found = analysis.analyze(problem, output, calc_second_order=False, conf_level=confidence, seed=seed)
    first, first_confidence, total, total_confidence = (
        np.asarray(found[key], dtype=np.float64) for key in ("S1", "S1_conf", "ST", "ST_conf")
    )
    left_out = float(missing.mean())
    return SobolIndices(tuple(ranges), first, first_confidence, total, total_confidence, mean, std, left_out)


def rig_output(p: RigParameters, output: str) -> Callable[[dict[str, Any]], Values]:
    """One of the outputs of a rig as a function of its parameters, for `sobol_indices`."""
    if output == CRITICAL_STIFFNESS:
        return lambda values: stability_map(p, **values).critical_pad_stiffness
    if output == FREQUENCY:
        return lambda values: stability_map(p, bands=False, **values).squeal_frequency
    if output == FOLD:
        return lambda values: zone_map(p, **values).fold_mu
    raise ParameterError(
        f"output = {output!r} is not known: it must be one of {CRITICAL_STIFFNESS}, {FOLD}, {FREQUENCY}"
    )


def squeal_probability(
    p: RigParameters, scatter: Mapping[str, float], samples: int = 4096, seed: int = 1
) -> tuple[float, float]:
    """Probability that a rig whose parameters scatter squeals by itself, and its standard error.

    scatter: name -> standard deviation as a share of the value, normally distributed and independent.

    Raises:
        ParameterError: a scatter is not above 0 and at most 0.2.
    """
    for name, share in scatter.items():
        if not 0.0 < share <= MOST_SCATTER:
            raise ParameterError(
                f"scatter of {name} = {share} is out of bounds: it must be above 0 and at most {MOST_SCATTER:g}"
            )
    generator = np.random.default_rng(seed)
    values: dict[str, Any] = {
        name: _value(p, name) * (1.0 + share * generator.standard_normal(samples)) for name, share in scatter.items()
    }
    share = float(np.mean(np.isfinite(stability_map(p, bands=False, **values).squeal_frequency)))
    return share, float(np.sqrt(max(share * (1.0 - share), 1.0 / samples) / samples))


def even_ranges(p: RigParameters, scatter: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Name -> the range about the rig's value over which an even spread has the standard deviation of `scatter`."""
    ranges = {}
    for name, share in scatter.items():
        ends = (_value(p, name) * (1.0 - math.sqrt(3.0) * share), _value(p, name) * (1.0 + math.sqrt(3.0) * share))
        ranges[name] = (min(ends), max(ends))
    return ranges


def _value(p: RigParameters, name: str) -> float:
    return 0.5 * (p.k1 + p.k2) if name == PAD_STIFFNESS else float(getattr(p, name))
