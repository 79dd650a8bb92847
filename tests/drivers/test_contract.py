"""The driver contract suite as a third party runs it: on ours, on the example of the tutorial, on broken ones."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig

from .test_bag_driver import PARAMETERS, RATE, write

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorials" / "driver.md"
RIG = f"/**/rig:\n  ros__parameters:\n    damping_x: 20.0\n    damping_y: 20.0\n    sample_rate: {RATE}\n"


def run_suite(*options, path=None):
    """The suite in a process of its own, without this repository's settings of pytest."""
    search = os.pathsep.join(filter(None, (str(path or ""), os.environ.get("PYTHONPATH", ""))))
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-c",
        os.devnull,
        "--rootdir",
        str(ROOT),
    ]
    done = subprocess.run(
        [*command, "--pyargs", "squeal_rig.testing.driver_contract", *map(str, options)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": search},
        check=False,
        timeout=1200,
    )
    return done.returncode, done.stdout + done.stderr


def install(folder, code, entry):
    """What pip leaves of a package that brings a driver."""
    (folder / "some_lab.py").write_text(code)
    metadata = folder / "some_lab-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: some-lab\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[squeal_rig.drivers]\n{entry}\n")


def passed(output):
    return int(re.search(r"(\d+) passed", output)[1])


def test_the_virtual_rig_keeps_it():
    code, output = run_suite("--driver", "virtual")
    assert code == 0, output
    assert passed(output) >= 19


@pytest.mark.slow
def test_a_bag_keeps_it(tmp_path):
    rig = Acquisition(VirtualRig(), PARAMETERS, RigSettings(sample_rate=RATE))
    rig.start(10**18)
    bag = write(tmp_path / "bag", [rig.next_block() for _ in range(300)])
    config, rig_config = tmp_path / "driver.yaml", tmp_path / "rig.yaml"
    config.write_text(f"driver: bag\nbag: {bag}\n")
    rig_config.write_text(RIG)
    code, output = run_suite("--driver", "bag", "--driver-config", config, "--rig-config", rig_config)
    assert code == 0, output
    assert passed(output) >= 18


@pytest.mark.slow
def test_opendaq_keeps_it_on_the_twin(twin):
    code, output = run_suite("--driver", "opendaq", "--driver-config", twin.config)
    assert code == 0, output
    assert passed(output) >= 20


def test_the_example_of_the_page_keeps_it(tmp_path):
    code = re.search(r"```python\n# some_lab\.py\n(.*?)```", PAGE.read_text(), re.DOTALL)[1]
    assert len(code.splitlines()) <= 70
    install(tmp_path, code, "bench = some_lab:Bench")
    config = tmp_path / "bench.yaml"
    config.write_text("driver: bench\nnoise: 0.5\n")
    status, output = run_suite("--driver", "bench", "--driver-config", config, path=tmp_path)
    assert status == 0, output
    assert passed(output) >= 18


# The virtual rig with one promise broken, and the test that has to notice.
BROKEN = {
    "truth that it has not": (
        "    def capabilities(self, settings):\n"
        "        return Capabilities(frozenset(), knows_truth=False, can_hit=True)",
        "as_many_samples",
    ),
    "micrometres": (
        "    def read(self, p):\n        r = super().read(p)\n        r.daq['x'] += 3.0\n        return r",
        "in_the_channels_units",
    ),
    "not a number": (
        "    def read(self, p):\n        r = super().read(p)\n        r.daq['y'][7] = float('nan')\n        return r",
        "is_finite",
    ),
    "a block that is short": (
        "    def read(self, p):\n        r = super().read(p)\n        return Reading(r.daq[:-1], r.truth[:-1])",
        "as_many_samples",
    ),
    "a block that is written again": (
        "    def read(self, p):\n        r = super().read(p)\n        o = self.__dict__.setdefault('o', r)\n"
        "        o.daq[:] = r.daq\n        return o",
        "never_written_again",
    ),
    "constants that move": (
        "    def capabilities(self, settings):\n"
        "        return Capabilities(frozenset({'mass'}), knows_truth=True, can_hit=True)",
        "name_set_points",
    ),
    "obeys after the safe command": ("    def make_safe(self):\n        pass", "obeys_nobody_until_reset"),
    "a hit that it cannot give": ("    def impact(self, x, y):\n        raise DriverError('no hammer')", "a_hit_is"),
    "a reset that is none": ("    def reset(self):\n        motion = self._opened()\n", "obeys_nobody_until_reset"),
    "stamps although the rig counts": (
        "    def read(self, p):\n        r = super().read(p)\n        return Reading(r.daq, r.truth, stamp=5)",
        "left_to_the_rig",
    ),
}
IMPORTS = """
from squeal_rig.errors import DriverError
from squeal_rig.instruments.driver import Capabilities, Reading
from squeal_rig.instruments.virtual import VirtualRig

"""


@pytest.mark.long  # a run of the suite each
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_promise_is_noticed(name, tmp_path):
    body, test = BROKEN[name]
    install(tmp_path, f"{IMPORTS}class Bench(VirtualRig):\n{body}\n", "bench = some_lab:Bench")
    code, output = run_suite("--driver", "bench", "--patience", "20", path=tmp_path)
    assert code == 1, output
    assert re.search(rf"FAILED \S*{test}", output), output


def test_its_options_are_in_no_other_run():
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--driver", "virtual", "--collect-only", "-q", __file__, "-k", "nothing"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 4  # pytest: an option that nobody knows
    assert "--driver" in done.stderr
