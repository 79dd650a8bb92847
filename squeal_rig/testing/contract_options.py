"""Options of the driver contract suite: a pytest plugin that adds them to runs of the suite, and to no other."""

from __future__ import annotations

import pytest

_SUITE = "squeal_rig.testing.driver_contract"


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests(early_config: pytest.Config, parser: pytest.Parser, args: list[str]) -> None:
    """Add `--driver` and what goes with it; other plugins have options of that name, so only where it is asked for."""
    if not any(_SUITE in str(arg) for arg in args):
        return
    group = parser.getgroup("squeal_rig driver contract")
    group.addoption("--driver", help="name of the driver, as its package offers it", default="virtual")
    group.addoption("--driver-config", help="YAML file of the driver's own settings", default="")
    group.addoption("--rig-config", help="parameter file whose block for `rig` describes the rig", default="")
    group.addoption("--patience", help="longest wait for anything [s]", type=float, default=60.0)
