"""Published and calibrated numbers the model is held to, with their sources."""

import math

#: Preload F [N], belt speed V [m/s], critical pad stiffness [N/m] of the preset `yavuz_sen_2023` to three digits, and
#: the value the paper reads from its Figs. 5 to 9.
THRESHOLDS = (
    (27.0, 1.0, 6.259e7, 6.00e7),
    (50.0, 1.0, 4.811e7, 5.16e7),
    (79.0, 1.0, 3.873e7, 4.00e7),
    (200.0, 1.0, 2.265e7, 2.10e7),
    (248.0, 1.0, 1.959e7, 2.00e7),
    (50.0, 4.0, 6.802e7, 6.71e7),
    (128.0, 4.0, 5.735e7, 6.00e7),
    (200.0, 4.0, 5.119e7, 4.97e7),
)
#: Arm stiffness [N/m], frequency [Hz] of the preset's unstable mode at F = 300 N, V = 1 m/s, and the paper's Table 1.
FREQUENCIES = (
    (2e7, 1129.0, 958.0),
    (4e7, 1152.0, 1083.0),
    (6e7, 1174.0, 1119.0),
    (8e7, 1195.0, 1241.0),
    (10e7, 1215.0, 1538.0),
)


def same_to_digits(value, expected, digits):
    """Whether two numbers agree to a number of significant digits (half a unit of the last one)."""
    unit = 10.0 ** (math.floor(math.log10(abs(expected))) + 1 - digits)
    return abs(value - expected) <= 0.5 * unit
