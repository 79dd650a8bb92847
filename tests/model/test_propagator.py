"""The polynomial maps of the exact engine: their algebra, their agreement with the full equations, their bounds."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from squeal_rig.model import RigParameters
from squeal_rig.model.core.layout import L_PRE, pack
from squeal_rig.model.motion.cubic import TERMS, evaluate_all, monomials, multiply, substitute
from squeal_rig.model.motion.exact import empty_flow, workspace
from squeal_rig.model.motion.propagator import (
    AHEAD,
    BOUND,
    CONTACT_LIMITS,
    NEAR,
    OFF_BELT,
    OFF_BELT_LIMITS,
    TUBE,
    propagators,
    substeps_needed,
)
from squeal_rig.model.motion.series import evaluate, expand

INTERVAL = 1.0 / 51200.0
MONOMIALS = [powers for degree in range(4) for powers in itertools.combinations_with_replacement(range(4), degree)]
SEEDS = st.integers(0, 2**32 - 1)


def values(polynomials, z):
    """Polynomials (..., 35) at z, monomial by monomial."""
    return polynomials @ np.array([np.prod(z[list(powers)]) for powers in MONOMIALS])


def rig_and_maps(**changes):
    p = RigParameters().replace(damping_x=20.0, damping_y=20.0, **changes)
    q, flow = pack(p), empty_flow()
    h = INTERVAL / substeps_needed(q, INTERVAL, INTERVAL)
    propagators(q, h, flow)
    return q, flow, h


def random_state(random, flow):
    """Anywhere in the small range, with velocities of some 1 kHz."""
    return random.uniform(-1.0, 1.0, 4) * flow[NEAR] * [1.0, 1.0, 6e3, 6e3]


def maps_of(flow, contact):
    """Polynomials (4 steps, 4 components, 35)."""
    table = flow[:OFF_BELT] if contact else flow[OFF_BELT:CONTACT_LIMITS]
    return np.roll(table.reshape(TERMS, AHEAD, 4), -1, axis=1).transpose(1, 2, 0)


@given(seed=SEEDS)
@settings(max_examples=50)
def test_a_product_has_the_product_of_the_values(seed):
    random = np.random.default_rng(seed)
    a, b, out = np.zeros(TERMS), np.zeros(TERMS), np.zeros(TERMS)
    # Degrees 1 and 2: nothing is dropped.
    a[:5], b[:15] = random.normal(size=5), random.normal(size=15)
    multiply(a, b, out)
    z = random.normal(size=4)
    assert values(out, z) == pytest.approx(values(a, z) * values(b, z), rel=1e-12, abs=1e-12)
    multiply(b, a, out)
    assert values(out, z) == pytest.approx(values(a, z) * values(b, z), rel=1e-12, abs=1e-12)


@given(seed=SEEDS)
@settings(max_examples=50)
def test_sixteen_polynomials_at_once_have_the_values_of_each(seed):
    random = np.random.default_rng(seed)
    polynomials, z, out = random.normal(size=(16, TERMS)), random.normal(size=4), np.zeros(16)
    evaluate_all(polynomials.T.ravel(), *z, out)
    np.testing.assert_allclose(out, values(polynomials, z), rtol=1e-11, atol=1e-11)


@given(seed=SEEDS)
@settings(max_examples=50)
def test_composition_drops_only_terms_of_degree_4(seed):
    random = np.random.default_rng(seed)
    outer, inner = random.normal(size=(4, TERMS)), random.normal(size=(4, TERMS))
    outer[:, 5:15] *= 1e-4
    outer[:, 15:] *= 1e-8
    inner[:, 5:15] *= 1e-4
    inner[:, 15:] *= 1e-8
    out, z, of_inner = np.zeros((4, TERMS)), random.uniform(-1.0, 1.0, 4), np.zeros((TERMS, TERMS))
    monomials(inner, of_inner)
    substitute(outer, of_inner, out)
    # Parts of 1e-4 and 1e-8 as for r/L = 1e-4: what is dropped is 1e-12 times up to 500 on random polynomials.
    np.testing.assert_allclose(values(out, z), values(outer, values(inner, z)), rtol=0.0, atol=2e-9)


@given(seed=SEEDS, contact=st.booleans(), length=st.sampled_from([0.01, 0.1, 1.0]), k=st.floats(1e7, 1.2e8))
@settings(max_examples=100)
def test_maps_of_one_to_four_steps_agree_with_the_full_equations(seed, contact, length, k):
    q, flow, h = rig_and_maps(pad_stiffness=k, arm_length_1=length, arm_length_2=0.7 * length)
    start = random_state(np.random.default_rng(seed), flow)
    maps, state, w = maps_of(flow, contact), start.copy(), workspace()
    for n in range(AHEAD):
        expand(state, q, flow, contact, 1.0, h, 14, 12, w)
        evaluate(w, 14, 1.0, h, state)
        # NEAR_ERROR a step, as a share of the displacement; a velocity is h times less sure.
        error = np.abs(values(maps[n], start) - state) / [flow[NEAR], flow[NEAR], flow[NEAR] / h, flow[NEAR] / h]
        assert np.max(error) <= 4e-11 * (n + 1)


@given(seed=SEEDS, contact=st.booleans(), k=st.floats(1e7, 1.2e8), preload=st.floats(0.0, 400.0))
@settings(max_examples=100)
def test_y_stays_within_its_bounds_of_the_chord(seed, contact, k, preload):
    q, flow, h = rig_and_maps(pad_stiffness=k, preload=preload)
    start = random_state(np.random.default_rng(seed), flow)
    w, at = workspace(), np.empty(4)
    expand(start, q, flow, contact, 1.0, h, 14, 12, w)
    path = []
    for share in np.linspace(0.0, 1.0, 33):
        evaluate(w, 14, share, h, at)
        path.append(at.copy())
    path = np.array(path)
    assume(np.max(np.abs(path[-1, :2])) <= flow[NEAR])
    chord = path[0, 1] + np.linspace(0.0, 1.0, 33) * (path[-1, 1] - path[0, 1])
    away = np.max(np.abs(path[:, 1] - chord))
    limits = flow[CONTACT_LIMITS:OFF_BELT_LIMITS] if contact else flow[OFF_BELT_LIMITS : OFF_BELT_LIMITS + 6]
    closer = h * h / 8.0 * (limits[BOUND : BOUND + 5] @ np.concatenate([[1.0], np.abs(start)]))
    assert away <= closer
    assert away <= limits[TUBE]
    # And they are of use: the pad moves further than that in a step at a speed of omega r.
    assert limits[TUBE] <= 0.25 * (flow[NEAR] + abs(q[L_PRE]))
