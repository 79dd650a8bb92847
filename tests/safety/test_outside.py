"""The process beside the rig, watching a process of ours: whom it kills, and whom it leaves alone."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import squeal_rig

_START = str(Path(squeal_rig.__file__).parent / "nodes" / "start.py")
# Beats for a while, then does what the test says.
_WATCHED = """
import os, sys, time
from squeal_rig.safety.outside import Outside

beside = Outside([sys.executable, sys.argv[1], "watchdog"], "", {}, 4.5)
beside.arm(sys.argv[2] != "inactive")
for _ in range(40):
    beside.beat()
    time.sleep(0.02)
print("beaten", flush=True)
if sys.argv[2] == "ends":
    beside.close()
elif sys.argv[2] == "dies":
    os.kill(os.getpid(), 9)
elif sys.argv[2] == "loses it":
    beside._process.kill()
    beside._process.wait()
    assert not beside.running
    beside._started = -100.0
    beside.beat()
    assert beside.running and beside.restarts == 1
    time.sleep(60.0)
elif sys.argv[2] == "inactive":
    time.sleep(6.0)
    beside.close()
else:
    time.sleep(60.0)
"""


@pytest.mark.parametrize(
    ("what", "code", "said"),
    [
        ("ends", 0, ""),
        pytest.param("inactive", 0, "", marks=pytest.mark.slow),
        ("silent", -signal.SIGKILL, "silent for "),
        pytest.param("loses it", -signal.SIGKILL, "silent for ", marks=pytest.mark.slow),
        ("dies", -signal.SIGKILL, "has ended while it drove the rig"),
    ],
)
def test_who_is_silent_or_dies_while_it_drives_a_rig_is_stopped_from_outside(tmp_path, what, code, said):
    errors = tmp_path / "errors"
    with errors.open("wb") as stream:
        watched = subprocess.Popen(
            [sys.executable, "-c", _WATCHED, _START, what], stdout=subprocess.PIPE, stderr=stream, text=True
        )
        output, _ = watched.communicate(timeout=300.0)  # the process beside has no end of it
    assert output == "beaten\n"
    assert watched.returncode == code, errors.read_text()
    for _ in range(600):
        if said in errors.read_text():
            break
        subprocess.run(["sleep", "0.05"], check=True)
    text = errors.read_text()
    assert said in text
    assert ("emergency stop from outside" in text) == bool(said)
    assert "Traceback" not in text


# Asks a driver that refuses once, while nobody reads standard error any more, or who should stands still.
_REFUSED_ONCE = """
import os, sys
from squeal_rig.safety import watching

answers = [ConnectionRefusedError("held by another"), None]

def make_safe():
    answer = answers.pop(0)
    if answer is not None:
        raise answer

if sys.argv[1] == "full":
    os.set_blocking(2, False)
    try:
        while True:
            os.write(2, b"." * 65536)
    except BlockingIOError:
        os.set_blocking(2, True)
print(watching._made_safe(make_safe, "a test"), len(answers))
"""


@pytest.mark.parametrize("reader", ["gone", "full"])
def test_the_safe_command_is_asked_for_again_though_nobody_reads_that_it_was_refused(reader):
    reading, writing = os.pipe()
    if reader == "gone":
        os.close(reading)
    try:
        run = subprocess.run(
            [sys.executable, "-c", _REFUSED_ONCE, reader],
            check=True,
            stdout=subprocess.PIPE,
            stderr=writing,
            timeout=60.0,
            text=True,
        )
    finally:
        os.close(writing)
        if reader == "full":
            os.close(reading)
    assert run.stdout.startswith("the driver has accepted the safe command after ")
    assert run.stdout.endswith(" 0\n")


def test_a_watchdog_whose_rig_has_ended_before_it_ran_kills_nobody():
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    first = json.dumps({"rig": gone.pid, "driver": "", "settings": {}, "limit": 1.0})
    run = subprocess.run(
        [sys.executable, _START, "watchdog"], check=True, input=f"{first}\nA".encode(), capture_output=True, timeout=60
    )
    assert b"the rig's process has ended while it drove the rig" in run.stderr  # and we, its parent, are still here


def test_a_watchdog_that_cannot_load_the_driver_says_so_and_is_never_ready(capfd):
    from squeal_rig.safety.outside import Outside

    beside = Outside([sys.executable, _START, "watchdog"], "no_such_driver", {}, 1.0)
    try:
        for _ in range(6000):
            if beside.failed:
                break
            time.sleep(0.05)
        assert (beside.failed, beside.ready, beside.running) == (True, False, True)
    finally:
        beside.close()
    assert "the watchdog cannot load the driver 'no_such_driver'" in capfd.readouterr().err


def test_a_watchdog_that_cannot_be_started_again_ends_nobody(monkeypatch):
    from squeal_rig.safety import outside

    beside = outside.Outside([sys.executable, _START, "watchdog"], "", {}, 1.0)
    try:
        beside._process.kill()
        beside._process.wait()
        beside._started = -100.0

        def refused(*_arguments, **_more):
            raise OSError(11, "Resource temporarily unavailable")

        with monkeypatch.context() as patched:
            patched.setattr(outside.subprocess, "Popen", refused)
            beside.beat()
        assert (beside.running, beside.restarts) == (False, 1)
        beside._started = -100.0
        beside.beat()
        assert (beside.running, beside.restarts) == (True, 2)
    finally:
        beside.close()
