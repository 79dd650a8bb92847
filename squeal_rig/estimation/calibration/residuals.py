"""A rig against its targets, number by number, and the preset file that a calibration leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from squeal_rig.configuration.declared import declarations
from squeal_rig.configuration.files import yaml_scalar
from squeal_rig.estimation.calibration.evaluation import SIMULATED, Evaluator
from squeal_rig.estimation.calibration.identifiability import identifiability
from squeal_rig.estimation.calibration.problem import Calibration, within_bounds
from squeal_rig.estimation.calibration.search import EQUALLY_GOOD, Found
from squeal_rig.estimation.calibration.targets import KINDS, Target
from squeal_rig.model.parameters import RigParameters

#: Digits a preset is written with: what the search determines, and the same on every machine.
_DIGITS = 8
_UNITS = {
    "critical_pad_stiffness": "N/m",
    "squeal_frequency": "Hz",
    "nonlinear_frequency": "Hz",
    "contact_loss": "s, share",
    "peak_displacement_jump": "N",
}


@dataclass(frozen=True)
class Residual:
    """One target beside what the rig gives, nan: none; `error` relative, of contact loss a difference of shares.

    `weight` is that of the kind in the calibration; with 0 the number is shown, and was not asked for.
    """

    target: Target
    computed: float
    error: float
    weight: float


def residuals(problem: Calibration, p: RigParameters, kinds: tuple[str, ...] = KINDS) -> list[Residual]:
    """Every target of these kinds beside what the rig `p` gives; contact loss is computed as a share of time."""
    judged = Evaluator(problem).of_rig(p, kinds)
    return [
        Residual(target, float(value), float(error), problem.weights.get(kind, 0.0))
        for kind in judged.computed
        for target, value, error in zip(
            problem.targets.of(kind), judged.computed[kind][0], judged.errors[kind][0], strict=True
        )
    ]


def summary(items: list[Residual], kind: str) -> str:
    """Mean, RMS and largest error of one kind in words; a root that is missing counts in none of them."""
    errors = np.abs([item.error for item in items if item.target.kind == kind and not math.isnan(item.error)])
    if not errors.size:
        return f"{kind}: none"
    rms = math.sqrt(float(np.mean(errors**2)))
    return f"{kind}: mean {errors.mean():.2%}, RMS {rms:.2%}, largest {errors.max():.2%}"


def rounded(found: Found) -> RigParameters:
    """The rig found, its free parameters rounded to the digits a preset is written with, within their bounds."""
    names = [*(item.name for item in found.problem.free), *found.problem.tied]
    values = {name: float(f"{getattr(found.rig, name):.{_DIGITS}g}") for name in names}
    return found.rig.replace(**{name: within_bounds(name, value) for name, value in values.items()})


def shown_kinds(problem: Calibration) -> tuple[str, ...]:
    """Kinds worth a line: those of the linear model, and of the nonlinear one what was asked for."""
    return tuple(kind for kind in KINDS if kind not in SIMULATED or problem.weights.get(kind, 0.0) > 0.0)


def residual_lines(items: list[Residual]) -> list[str]:
    """The table of residuals as lines of text, a kind after the other."""
    lines = [f"{'target':24s} {'k [N/m]':>9s} {'F [N]':>6s} {'V':>3s} {'asked':>10s} {'computed':>10s} {'error':>8s}"]
    for item in items:
        t = item.target
        asked, computed = _number(t.value), _number(item.computed)
        k = "" if t.kind == "critical_pad_stiffness" else f"{t.pad_stiffness:.3g}"
        f = "" if t.kind == "peak_displacement_jump" else f"{t.preload:g}"
        error = "" if math.isnan(item.error) else f"{item.error:+8.2%}"
        mark = "" if item.weight > 0.0 else "  (not asked for)"
        name = f"{t.kind} [{_UNITS[t.kind]}]" if len(t.kind) < 20 else t.kind
        lines.append(f"{name:24s} {k:>9s} {f:>6s} {t.belt_speed:3g} {asked:>10s} {computed:>10s} {error:>8s}{mark}")
    lines += [summary(items, kind) for kind in KINDS if any(item.target.kind == kind for item in items)]
    return lines


def spread_lines(found: Found) -> list[str]:
    """What the targets determine, as lines of text."""
    known = identifiability(found)
    lines = [f"{len(found.near)} sets seen have a loss within {EQUALLY_GOOD - 1.0:.0%} of the best; they spread over"]
    for name, low, high in zip(known.names, known.lower, known.upper, strict=True):
        wide = "  (poorly determined)" if name in known.wide else ""
        lines.append(f"  {name:20s} {low:12.5g} ... {high:12.5g}{wide}")
    lines.append(
        "singular values of d(error)/d(relative change): " + " ".join(f"{s:.2g}" for s in known.singular_values)
    )
    lines += [f"hardly seen by any target: {direction}" for direction in known.undetermined()]
    return lines


def write_preset(found: Found, path: Path, command: str) -> None:
    """Write the calibrated rig as a preset, with how it was made, its residuals and its spread as comments."""
    p = rounded(found)
    items = residuals(found.problem, p, shown_kinds(found.problem))
    head = [
        found.problem.title,
        f"Made by: {command}",
        f"Loss ({found.problem.measure}) {found.loss:.6f}; the starts ended at "
        + ", ".join(f"{loss:.6f}" for loss in sorted(found.starts)),
        *([f"{found.missing} roots that the targets ask for do not exist: this is no fit."] if found.missing else []),
        *([f"Demands or limits are broken by {found.outside:.3g}."] if found.outside > 0.0 else []),
        "",
        *residual_lines(items),
        "",
        *spread_lines(found),
    ]
    text = "".join(f"# {line}".rstrip() + "\n" for line in head)
    for name, declaration in declarations(RigParameters).items():
        unit = f"  # [{declaration.unit}]" if declaration.unit else ""
        text += f"{name}: {yaml_scalar(getattr(p, name))}{unit}\n"
    path.write_text(text, encoding="utf-8")


def _number(value: float) -> str:
    return "none" if math.isnan(value) else f"{value:.5g}"
