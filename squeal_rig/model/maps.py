"""Stability over grids of parameters, millions of points at a time.

The model is the linear one, Eqs. (3.1), (3.2): contact kept, geometry to first order about r = 0. Its stiffness matrix does not
depend on where the equilibrium lies (with friction that sees the slip its damping does, through N at the linear
equilibrium), so no equation has to be solved by iteration. `eigenvalues(p)` without `linear=True` differs from it by
the arms' rotation at the exact equilibrium, 1e-5 to 1e-4 of lambda at the preset.

Eigenvalues: with equal damping c in x and y (or none), m lambda^2 + c lambda + kappa = 0 for each eigenvalue kappa of K, in
closed form. Else the characteristic quartic lambda^4 + a1 lambda^3 + a2 lambda^2 + a3 lambda + a4 (coefficients as in
squeal_rig.model.stability), its four roots at once by Aberth's method (Math. Comp. 27, 1973, 339-344), started from the
eigenvalues at the mean damping. Like any solver, both lose digits near a double eigenvalue, the flutter boundary itself.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.errors import ParameterError
from squeal_rig.model.band import linear_terms, stability_bounds
from squeal_rig.model.declared import checked, declarations
from squeal_rig.model.dynamics import Vector
from squeal_rig.model.parameters import RigParameters
from squeal_rig.model.roots import FIELDS, fill_points

_CHUNK = 4096


@dataclass(frozen=True)
class StabilityMap:
    """Stability over a grid; arrays of the grid's shape, SI units.

    - growth_rate [1/s]: largest Re lambda
    - squeal_frequency [Hz]: |Im lambda|/2pi of that eigenvalue where it grows (Re lambda > 1e-6 |lambda|), else nan
    - critical_pad_stiffness, upper_pad_stiffness [N/m]: as `stability_band`, nan where no stiffness is unstable
    - margin: (k_cr - k)/k_cr with k = (k1 + k2)/2
    - eigenvalues: complex, one axis of 4 more, largest real part first; only where asked for
    """

    growth_rate: Vector
    squeal_frequency: Vector
    critical_pad_stiffness: Vector
    upper_pad_stiffness: Vector
    margin: Vector
    eigenvalues: NDArray[np.complex128] | None
