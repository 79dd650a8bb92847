"""The page while others flood it, and its sound against the bag: slow, and measured rather than judged by the clock."""

import asyncio
import contextlib
import itertools
import json
import re
import struct
import time

import numpy as np
import pytest
from scipy.signal import resample_poly

pytest.importorskip("rclpy")
aiohttp = pytest.importorskip("aiohttp")

from squeal_rig.recording import Bag, samples_from_cdr  # noqa: E402
from squeal_rig.view.sound import Resampler  # noqa: E402
from tests.graph.processes import parameters  # noqa: E402

pytestmark = pytest.mark.slow

_CLIENTS, _STOPS, _LISTENED = 20, 200, 20.0


@pytest.fixture(scope="module")
def served(compiled, processes, observer, tmp_path_factory):
    """Rig, recorder and page at 51.2 kHz; the page's address and the bag."""
    bag = tmp_path_factory.mktemp("bag") / "run"
    simulator = processes.node("simulator", *parameters(supervisor_required=False, damping_x=20.0, damping_y=20.0))
    recorder = processes.node("recorder", *parameters(directory=bag))
    page = processes.node("page", *parameters(port=0, control=True))
    observer.wait_for(lambda: "http://" in page.errors or not page.running, "the page's address", 300.0)
    observer.wait_for(lambda: observer.state() == "active", "an active rig", 300.0)
    return re.search(r"http://\S+?(?=/;)", page.errors)[0], bag, recorder, page, simulator


async def flood(session, url, ending):
    """Everything at once: a socket that talks without end and does not read, and commands one after the other."""
    with contextlib.suppress(aiohttp.ClientError, ConnectionError, asyncio.CancelledError):
        async with session.ws_connect(f"{url}/ws") as socket:
            await socket.send_str('{"sound": 48000}')
            while not ending.is_set():
                with contextlib.suppress(aiohttp.ClientError, ConnectionError, asyncio.TimeoutError):
                    await asyncio.wait_for(socket.send_str('{"seek": 1}'), 0.05)
                async with session.post(f"{url}/command", json={"do": "set", "values": {"preload": 1e9}}):
                    pass


def test_the_emergency_stop_acts_while_the_page_is_flooded(served, observer, measured):
    url = served[0]

    async def work():
        ending, times = asyncio.Event(), []
        connector = aiohttp.TCPConnector(limit=0)
        async with aiohttp.ClientSession(connector=connector) as others, aiohttp.ClientSession() as operator:
            floods = [asyncio.create_task(flood(others, url, ending)) for _ in range(_CLIENTS)]
            await asyncio.sleep(2.0)
            for _ in range(_STOPS):
                begin = time.monotonic()
                async with operator.post(f"{url}/command", json={"do": "emergency_stop"}) as answer:
                    told = await answer.json()
                times.append(time.monotonic() - begin)
                assert told["done"], told
                await asyncio.sleep(0.02)
            ending.set()
            for task in floods:
                task.cancel()
            await asyncio.gather(*floods, return_exceptions=True)
        return times

    times = 1e3 * np.array(asyncio.run(work()))
    measured(
        f"emergency stop from the request to the driver's acceptance told, {_CLIENTS} clients flooding:"
        f" median {np.median(times):.1f} ms, p99 {np.percentile(times, 99):.1f} ms, worst {times.max():.1f} ms"
    )
    assert observer.trigger("reset")[0]


def test_what_is_heard_is_the_bag_resampled_sample_for_sample(served, observer, measured):
    url, bag, recorder, page, _ = served

    async def work():
        pieces, end = [], time.monotonic() + _LISTENED
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{url}/ws") as socket:
            await socket.send_str('{"sound": 48000}')
            while time.monotonic() < end:
                data = (await socket.receive()).data
                (size,) = struct.unpack_from("<I", data)
                head = json.loads(data[4 : 4 + size])
                if head["kind"] == "sound":
                    pieces.append((head["origin"], head["first"], np.frombuffer(data, "<f4", offset=4 + size)))
        return pieces

    observer.set({"preload": 300.0, "belt_speed": 1.0}, atomically=True)  # it squeals
    cpu = page.cpu_seconds()
    pieces = asyncio.run(work())
    measured(f"page with one listener: {(page.cpu_seconds() - cpu) / _LISTENED:.2f} of a core")
    assert recorder.end()[0] == 0
    blocks = [samples_from_cdr(m.data).samples for m in Bag(bag).messages(["/daq/samples"])]
    recorded = {int(seq): x for block in blocks for seq, x in zip(block["seq"], block["x"], strict=True)}
    heard = equal = 0
    for origin in sorted({piece[0] for piece in pieces}):
        mine = [piece for piece in pieces if piece[0] == origin]
        assert all(a[1] + len(a[2]) == b[1] for a, b in itertools.pairwise(mine)), "a gap"
        sound = np.concatenate([piece[2] for piece in mine])
        count = 0
        while origin + count in recorded:
            count += 1
        x = np.array([recorded[origin + k] for k in range(count)])
        design = Resampler(51200, 48000)
        offline = resample_poly(1e6 * x, design.up, design.down).astype(np.float32)[: len(sound) + mine[0][1]]
        usable = offline[mine[0][1] : len(offline) - 400]
        heard += len(usable)
        equal += int(np.count_nonzero(usable == sound[: len(usable)]))
    measured(f"sound: {heard} samples of {len(pieces)} pieces, {equal} equal to the bag resampled offline")
    # Where a busy machine lost a block, the sound begins anew and the bag has a gap: no fault of the sound.
    begun, share = len({piece[0] for piece in pieces}), heard / 48000 / _LISTENED
    measured(f"sound: begun {begun} times, {share:.2f} of the time heard")
    assert equal == heard > 0
    assert np.ptp(sound) > 1.0  # [um]: something is heard
