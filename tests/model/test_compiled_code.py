"""Compiled kernels: nothing is compiled at import, and compiled code is kept on disk for as long as it is right."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import squeal_rig.model

ROOT = Path(squeal_rig.__file__).parents[1]

LIST_KERNELS = """
import sys
import squeal_rig.model.motion.ensemble, squeal_rig.model.linear.maps, squeal_rig.model.motion.trajectory
from numba.core.dispatcher import Dispatcher
kernels = {}
for name, module in list(sys.modules.items()):
    if name.startswith("squeal_rig."):
        for value in vars(module).values():
            if isinstance(value, Dispatcher):
                kernels[value.py_func.__name__] = value
"""

SIMULATE = """
from squeal_rig.model import RigParameters, simulate, state_derivative
from squeal_rig.model.motion import columns, rk4
p, start = RigParameters(), [1e-6, 0.0, 0.0, 0.0]
run = simulate(p, 1e-6, 1e6, start, engine="{engine}")
acceleration = state_derivative(p, start)[2]
stats = {kernel}.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), run.vx[1] / 1e-6, acceleration)
"""


def python(code, root=ROOT, **environment):
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root), **environment},
        capture_output=True,
        text=True,
        timeout=600,  # the first process compiles, on a busy machine too
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


def test_importing_the_model_compiles_nothing():
    compiled = python(
        LIST_KERNELS
        + """
for name, kernel in kernels.items():
    print(name, len(kernel.signatures), kernel.stats.cache_hits.total() + kernel.stats.cache_misses.total())
"""
    )
    names, counts = compiled[::3], compiled[1::3] + compiled[2::3]
    assert {"acceleration", "spring_force", "friction_ratio", "advance"} <= set(names)
    assert set(counts) == {"0"}


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "kernel"), [("exact", "columns._advance_plainly"), ("rk4", "rk4.advance")])
def test_a_second_process_loads_compiled_code_and_does_not_compile(tmp_path, engine, kernel):
    code = SIMULATE.format(engine=engine, kernel=kernel)
    hits, misses, *first = python(code, NUMBA_CACHE_DIR=str(tmp_path))
    assert (hits, misses) == ("0", "1")
    hits, misses, *second = python(code, NUMBA_CACHE_DIR=str(tmp_path))
    assert (hits, misses) == ("1", "0")
    # The last bits may differ: docs/decisions/0026.
    assert list(map(float, second)) == pytest.approx(list(map(float, first)), rel=1e-9)


AFTER_WARM_UP = (
    """
from squeal_rig.instruments.warm_up import warm_up
warm_up()
"""
    + LIST_KERNELS
    + """
def compiled():
    return sum(kernel.stats.cache_hits.total() + kernel.stats.cache_misses.total() for kernel in kernels.values())
before = compiled()
import numpy as np
from squeal_rig.model import *
p = RigParameters(preload=300.0, damping_x=20.0, damping_y=20.0)
start = displaced_state(p, 30.0)
for changes in ({}, {"friction_direction": "slip"}, {"friction_speed": "slip"}):
    q = p.replace(**changes)
    run = simulate(q, 1e-3, initial_state=start)
    run.t, run.tangential_force
    list(simulate_blocks(q, 1e-3))
    energy_balance(q, 1e-3), contact_events(q, 1e-3, initial_state=start)
    simulate_many([q], 1e-3), simulate_many(q, 1e-3, traces=True, settle=1e-3, mass=[10.0, 12.0])
    stability_map(q, k1=np.array([1e7, 2e7])), stability_report(q), eigenvalues(q, linear=True)
print(before, compiled() - before)
"""
)


@pytest.mark.slow
def test_after_a_warm_up_nothing_is_left_to_compile():
    before, more = map(int, python(AFTER_WARM_UP))
    assert before > 20
    assert more == 0


@pytest.mark.slow
def test_code_compiled_from_an_older_right_hand_side_is_not_used(tmp_path):
    """numba looks for changes in a kernel's own file only; the engine is in another one than the physics."""
    for folder in ("squeal_rig", "config"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    cache = str(tmp_path / "cache")
    # The exact engine has no right-hand side to change: it expands the equations itself.
    code = SIMULATE.format(engine="rk4", kernel="rk4.advance")
    *_, before, right_before = map(float, python(code, tmp_path, NUMBA_CACHE_DIR=cache))
    forces = tmp_path / "squeal_rig" / "model" / "core" / "forces.py"
    text = forces.read_text(encoding="utf-8")
    changed = text.replace("return fx / q[MASS], fy / q[MASS]", "return fx / q[MASS] + 1000.0, fy / q[MASS]")
    assert changed != text
    forces.write_text(changed, encoding="utf-8")
    *_, after, right_after = map(float, python(code, tmp_path, NUMBA_CACHE_DIR=cache))
    # One step of 1e-6 s: the mean acceleration differs from that at its start by (omega h)^2.
    assert before == pytest.approx(right_before, rel=1e-4)
    assert right_after == pytest.approx(right_before + 1000.0, rel=1e-9)
    assert after == pytest.approx(right_after, rel=1e-4)


def test_no_public_name_of_the_model_is_also_a_module():
    """Names are imported when asked for; a module of the same name would hide them once it is loaded."""
    modules = {path.stem for path in (ROOT / "squeal_rig" / "model").glob("*.py")}
    assert not modules & set(squeal_rig.model.__all__)


def test_parameters_and_presets_need_no_compiler():
    loaded = python(
        "import sys; from squeal_rig.model import RigParameters; RigParameters(); print('numba' in sys.modules)"
    )
    assert loaded == ["False"]
