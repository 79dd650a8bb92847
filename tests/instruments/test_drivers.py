"""Drivers by name: what an installed package declares in its entry points, and nothing else."""

import sys

import pytest

from squeal_rig.errors import DriverError
from squeal_rig.instruments.driver import driver_class
from squeal_rig.instruments.virtual import VirtualRig


def install(folder, distribution, code, *entries):
    """What pip leaves of a package that brings drivers: a module and the metadata beside it."""
    module = distribution.replace("-", "_")
    (folder / f"{module}.py").write_text(code)
    metadata = folder / f"{module}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("\n".join(["[squeal_rig.drivers]", *entries]))


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """A folder that packages are installed into, as with `pip install --target`."""
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_the_virtual_rig_is_a_driver_like_any_other():
    assert driver_class("virtual") is VirtualRig


def test_an_unknown_name_is_refused_with_those_there_are(packages):
    install(packages, "some-lab", "class Bench: pass\n", "bench = some_lab:Bench")
    assert driver_class("bench").__module__ == "some_lab"
    with pytest.raises(DriverError, match=r"^driver = 'steam' is not known: there are bag, bench, opendaq, virtual$"):
        driver_class("steam")


def test_a_name_that_two_packages_offer_is_refused(packages):
    install(packages, "some-lab", "class Bench: pass\n", "virtual = some_lab:Bench")
    with pytest.raises(DriverError, match=r"offered more than once: by some_lab:Bench and squeal_rig"):
        driver_class("virtual")


@pytest.mark.parametrize("code", ["import a_library_that_is_not_there\n", "", "1 / 0\n", "raise SystemExit(3)\n"])
def test_a_driver_that_cannot_be_loaded_is_named(packages, code):
    sys.modules.pop("some_lab", None)
    install(packages, "some-lab", code, "bench = some_lab:Bench")
    with pytest.raises(DriverError, match=r"^driver = 'bench' cannot be loaded from some_lab:Bench: "):
        driver_class("bench")
