"""The process beside a node: answers, the latest question wins, and it ends whatever happens."""

import os
import signal
import sys
import threading
import time

import pytest

from squeal_rig.graph.beside import Beside

# Doubles numbers; sleeps so long [s] for a negative one, ends for 13, says what is no JSON for 14.
SCRIPT = """
import json, os, sys, time
print('"ready"', flush=True)
for line in sys.stdin:
    number = json.loads(line)["number"]
    if number < 0: time.sleep(-number)
    if number == 13: os._exit(3)
    print("{" if number == 14 else json.dumps(2 * number), flush=True)
"""


@pytest.fixture
def woken():
    return threading.Event()


@pytest.fixture
def beside(woken):
    made = Beside([sys.executable, "-c", SCRIPT], woken.set, patience=0.3, limit=60.0)
    yield made
    made.close()


def answer(beside, woken, patience=60.0):
    """The next answer, looked for as a node does: when woken and now and then."""
    deadline = time.monotonic() + patience
    while (found := beside.look()) is None:
        assert time.monotonic() < deadline
        woken.wait(0.05)
        woken.clear()
    return found


def test_questions_are_answered(beside, woken):
    for number in (1, 2):
        beside.ask({"number": number})
        assert answer(beside, woken) == ({"number": number}, 2 * number, "")
    assert beside.look() is None


def test_a_question_that_waits_at_the_close_starts_no_process_again(beside, woken):
    beside.ask({"number": -30})
    beside.ask({"number": 1})
    beside.close()
    assert beside.look() is None
    assert beside._process is None


def test_of_several_questions_the_latest_is_answered(beside, woken):
    for number in range(50):
        beside.ask({"number": number})
    found = [answer(beside, woken)]
    while found[-1][0]["number"] != 49:
        found.append(answer(beside, woken))
    assert len(found) <= 2


def test_a_long_computation_is_given_up_for_a_newer_question(beside, woken):
    beside.ask({"number": 1})
    answer(beside, woken)
    beside.ask({"number": -600})
    beside.ask({"number": 5})
    assert answer(beside, woken) == ({"number": 5}, 10, "")


def test_one_that_never_ends_is_given_up(beside, woken):
    beside._limit = 2.0
    beside.ask({"number": -600})
    asked, found, why = answer(beside, woken)
    assert (asked, found) == ({"number": -600}, None)
    assert why == "it took longer than 2 s"
    beside._limit = 60.0
    beside.ask({"number": 6})
    assert answer(beside, woken)[1] == 12


@pytest.mark.slow
def test_a_process_that_starts_slowly_is_waited_for(woken):
    slow = Beside([sys.executable, "-c", "import time\ntime.sleep(9.0)\n" + SCRIPT], woken.set, patience=6.0, limit=6.0)
    try:
        slow.ask({"number": 1})
        slow.ask({"number": 2})
        assert answer(slow, woken) == ({"number": 1}, 2, "")
        assert answer(slow, woken) == ({"number": 2}, 4, "")
        assert slow.ended == 0
    finally:
        slow.close()


@pytest.mark.parametrize("number", [13, 14])
def test_a_process_that_ends_by_itself_is_asked_once_more_and_then_no_more(beside, woken, number):
    beside.ask({"number": number})
    asked, found, why = answer(beside, woken)
    assert (asked["number"], found, beside.ended) == (number, None, 2)
    assert why.startswith("the process that computes it ended with ")
    beside.ask({"number": 7})
    assert answer(beside, woken)[1] == 14


def test_a_process_that_is_killed_is_started_again(beside, woken):
    beside.ask({"number": 1})
    answer(beside, woken)
    os.kill(beside._process.pid, signal.SIGKILL)
    beside.ask({"number": 2})
    assert answer(beside, woken) == ({"number": 2}, 4, "")
    assert beside.ended >= 1
