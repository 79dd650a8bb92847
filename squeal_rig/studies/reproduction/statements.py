"""The eight statements of the paper's conclusions, each tested on computed data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from squeal_rig.model.linear.eigen import is_unstable
from squeal_rig.studies.reproduction.linear import Locus, Values
from squeal_rig.studies.reproduction.nonlinear import PeakCurve, SpectrumCase, TableRow

AGREES, DIFFERS = "agrees", "differs"
#: "Similar" frequencies: within the largest error the paper itself reports, Table 1.
_SIMILAR = 0.0856
#: "Significant" separation: more than a tenth of the time.
_SIGNIFICANT = 0.1
# A gap of two equal frequencies is rounding below this share.
_ROUNDING = 1e-12
_JUMP_TOLERANCE = 0.05
_PAPER_PRELOADS = (50.0, 300.0)


@dataclass(frozen=True)
class Statement:
    """A statement of the conclusions, whether the rig agrees, and the numbers that say so."""

    text: str
    verdict: str
    evidence: str


def judged(text: str, agrees: bool, evidence: str) -> Statement:
    """A statement with its verdict."""
    return Statement(text, AGREES if agrees else DIFFERS, evidence)


def mode_coupling(loci: Sequence[Locus]) -> Statement:
    """1. Both modes meet in frequency at k_cr, and one grows beyond it."""
    gaps, grows = [], True
    for locus in loci:
        frequencies = np.sort(np.abs(locus.eigenvalues.imag), axis=1)[:, [1, 3]]
        gap = (frequencies[:, 1] - frequencies[:, 0]) / frequencies[:, 1]
        beyond = locus.stiffness > locus.k_cr
        gaps.append((float(gap[~beyond][0]), float(gap[beyond].max())))
        growing = np.array([is_unstable(values) for values in locus.eigenvalues])
        grows = grows and bool((growing == beyond).all())
    coupled = all(beyond < 1e-3 < below for below, beyond in gaps)
    evidence = (
        f"gap of the two frequencies beyond k_cr: {max(_ROUNDING, *(g[1] for g in gaps)):.0e} of the frequency or less,"
        f" at k = 0: {min(g[0] for g in gaps):.2f} or more"
    )
    return judged("Mode coupling triggers the instability.", coupled and grows, evidence)


def preload_lowers(preloads: Values, speeds: Values, critical: Values) -> Statement:
    """2. k_cr falls with preload at every belt speed, from the lowest preload on at which there is one."""
    falls = []
    for row in critical:
        first = int(np.argmax(np.isfinite(row)))
        falls.append(bool(np.isfinite(row[first:]).all() and (np.diff(row[first:]) < 0.0).all()))
    worst = [f"{v:g}" for v, ok in zip(speeds, falls, strict=True) if not ok]
    evidence = f"k_cr falls from {preloads[0]:g} to {preloads[-1]:g} N at V = {speeds[0]:g} to {speeds[-1]:g} m/s"
    return judged(
        "A higher preload lowers the critical pad stiffness at all belt speeds.",
        all(falls),
        evidence if not worst else f"not at V = {', '.join(worst)} m/s",
    )


def speed_raises(preloads: Values, speeds: Values, critical: Values) -> Statement:
    """3. k_cr rises with belt speed at every preload of the paper."""
    chosen = (preloads >= _PAPER_PRELOADS[0]) & (preloads <= _PAPER_PRELOADS[1])
    rises = bool((np.diff(critical[:, chosen], axis=0) > 0.0).all())
    bounds = np.where(np.isnan(critical), np.inf, critical)  # no critical stiffness: above any
    low = bounds[-1, ~chosen] < bounds[0, ~chosen]
    evidence = f"k_cr rises from {speeds[0]:g} to {speeds[-1]:g} m/s at every preload of 50 to 300 N"
    if low.any():
        evidence += (
            f"; below {preloads[~chosen][low].max():.0f} N it falls, since there the friction law rises with speed"
        )
    return judged("A higher belt speed raises the critical pad stiffness at the same preload.", rises, evidence)


def frequencies_similar(rows: Sequence[TableRow]) -> Statement:
    """4. Linear and nonlinear squeal frequencies are similar."""
    errors = [row.error for row in rows]
    evidence = (
        f"they differ by {min(errors):.1%} to {max(errors):.1%}, the paper's by {_SIMILAR:.1%} at most;"
        " the rig's nonlinear frequency lies below the linear one, the paper's above"
    )
    return judged("Linear and nonlinear squeal frequencies are similar.", max(errors) <= _SIMILAR, evidence)


def superharmonics_when_unstable(cases: Sequence[SpectrumCase]) -> Statement:
    """5. Super-harmonics appear in the cases that the linear analysis calls unstable."""
    agree = all(case.present == case.unstable == case.paper_present for case in cases)
    found = ", ".join(f"{case.preload:g} N / {case.stiffness / 1e7:g}e7" for case in cases if case.present)
    evidence = (
        f"found at {found}: the unstable ones of {len(cases)} cases, as in Fig. 10" if agree else f"found at {found}"
    )
    return judged("Super-harmonics appear where the linear analysis says unstable.", agree, evidence)


def separation_at_high_stiffness(rows: Sequence[TableRow]) -> Statement:
    """6. Separation is significant at high pad stiffness, and little at low."""
    shares = [row.contact_loss_share for row in rows]
    rises = bool((np.diff(shares) > 0.0).all())
    agrees = rises and shares[-1] > _SIGNIFICANT and shares[0] < _SIGNIFICANT
    evidence = (
        f"share of time off the belt {', '.join(f'{share:.3f}' for share in shares)} over k"
        f" ({'rising' if rises else 'not rising throughout'}), {shares[0]:.0%} at the lowest, where the paper has none"
    )
    return judged("Surface separation becomes significant at high pad stiffness.", agrees, evidence)


def deviation_with_separation(rows: Sequence[TableRow]) -> Statement:
    """7. Linear frequencies deviate more as separation grows."""
    errors, shares = [row.error for row in rows], [row.contact_loss_share for row in rows]
    correlation = float(np.corrcoef(errors, shares)[0, 1])
    evidence = (
        f"error {', '.join(f'{error:.1%}' for error in errors)} over shares"
        f" {', '.join(f'{share:.3f}' for share in shares)}; correlation {correlation:.2f}"
    )
    return judged("Linear frequencies deviate as separation becomes significant.", correlation > 0.5, evidence)


def jumps_at_threshold(curves: Sequence[PeakCurve]) -> Statement:
    """8. The peak displacement jumps where the linear analysis changes from stable to unstable."""
    distances = []
    same = True
    for curve in curves:
        same = same and (curve.jump is None) == (curve.threshold is None)
        if curve.jump is not None and curve.threshold is not None:
            distances.append(abs(curve.jump / curve.threshold - 1.0))
    agrees = same and max(distances, default=0.0) <= _JUMP_TOLERANCE
    evidence = (
        f"{len(distances)} jumps, the furthest {max(distances, default=0.0):.1%} from the rig's own threshold preload"
    )
    return judged("The peak displacement jumps at the boundary of stability.", agrees, evidence)
