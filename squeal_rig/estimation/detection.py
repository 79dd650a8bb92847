"""How sure a tone is: detection and false alarm of one line of a spectrum over the lines around it, in closed form.

A line of white noise has exponential power. Its noise is not known but estimated, by an order statistic of lines around
it, which other tones among them do not spoil (Rohling, Radar CFAR Thresholding in Clutter and Multiple Target
Situations, IEEE Trans. AES-19, 1983, Eq. 37): the false alarm does not depend on the noise's level. Lines of a Hann
window three bins apart are independent in white noise, so the references are taken three bins apart.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ParameterError

Values = NDArray[np.float64]

#: References of a line, and the rank of the one that stands for the noise, counted from the smallest.
REFERENCES, RANK = 32, 24
#: Bins from a line to its first reference, and from one reference to the next: a Hann line is 4 bins wide.
GUARD, SPACING = 6, 3


def mean_of_rank(references: int = REFERENCES, rank: int = RANK) -> float:
    """Expectation of the order statistic over the mean, of independent exponential powers."""
    return math.fsum(1.0 / (references - i) for i in range(rank))


def false_alarm(tonality: float, references: int = REFERENCES, rank: int = RANK) -> float:
    """Probability that a line of white noise exceeds the noise estimated beside it by a factor in power."""
    factor = tonality / mean_of_rank(references, rank)
    return math.exp(math.fsum(-math.log1p(factor / (references - i)) for i in range(rank)))


def tonality_for(probability: float, references: int = REFERENCES, rank: int = RANK) -> float:
    """The factor in power over the estimated noise that white noise exceeds with a probability, in each line.

    Raises:
        ParameterError: the probability is not above 1e-30 and below 1.
    """
    if not 1e-30 < probability < 1.0:
        raise ParameterError(f"false_alarm = {probability} is out of bounds: it must be above 1e-30 and below 1")
    low, high = -40.0, 20.0  # of the factor's logarithm
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if false_alarm(math.exp(middle), references, rank) > probability else (low, middle)
    return math.exp(high)


def line_snr(amplitude: float, noise: float, samples: int, offset: float = 0.0) -> float:
    """Power of a tone over the mean power of noise in its line, under a Hann window.

    Args:
        amplitude: of the tone, any unit.
        noise: standard deviation of a sample of white noise, same unit.
        samples: in the window.
        offset: of the tone from the line [bins].

    Source: the window's coherent gain is 1/2, its equivalent noise bandwidth 3/2 bins (Harris, Proc. IEEE 66, 1978,
    Table I); its response beside the bin is sin(pi d)/(pi d (1 - d^2)).
    """
    response = float(np.sinc(offset)) / (1.0 - offset**2) if abs(abs(offset) - 1.0) > 1e-12 else 0.5
    return amplitude**2 * response**2 * samples / (4.0 * 1.5 * noise**2)


def detection_in_known_noise(snr: float, tonality: float) -> float:
    """Probability that a line with a tone of `snr` exceeds `tonality` times a noise that is known: Marcum's Q function,
    the tail of the noncentral chi-square of two degrees of freedom.
    """
    from scipy.stats import ncx2  # a second to import, and workers of campaigns have no need of it

    return float(ncx2.sf(2.0 * tonality, 2, 2.0 * snr)) if snr > 0.0 else math.exp(-tonality)


def detection(snr: float, tonality: float, references: int = REFERENCES, rank: int = RANK) -> float:
    """Probability that a line with a tone exceeds `tonality` times the noise estimated beside it.

    The tail in known noise, averaged over the estimate's density (of an order statistic of exponential powers).
    """
    from scipy.integrate import quad

    scale = mean_of_rank(references, rank)
    weight = math.log(rank) + math.lgamma(references + 1) - math.lgamma(rank + 1) - math.lgamma(references - rank + 1)

    def integrand(z: float) -> float:
        density = math.exp(weight - (references - rank + 1) * z + (rank - 1) * math.log(-math.expm1(-z)))
        return density * detection_in_known_noise(snr, tonality * z / scale)

    value, _ = quad(integrand, 1e-12, scale + 12.0, points=[0.5 * scale, scale, 2.0 * scale], limit=200)
    return float(min(1.0, value))


def reference_bins(line: int, count: int, references: int = REFERENCES) -> NDArray[np.int64]:
    """Indices of the references of one line of a spectrum of `count` lines: the nearest outside the guard, the mean and
    the last line left out.

    Raises:
        ParameterError: the spectrum is too short for them.
    """
    found: list[int] = []
    step = 0
    while len(found) < references:
        distance = GUARD + SPACING * step
        if distance >= count:
            raise ParameterError(
                f"a spectrum of {count} lines has no {references} references {SPACING} bins apart: lengthen the window"
            )
        found += [bin_ for bin_ in (line - distance, line + distance) if 2 <= bin_ <= count - 2]
        step += 1
    return np.array(found[:references], dtype=np.int64)
