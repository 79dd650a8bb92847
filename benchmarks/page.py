"""The operator's page, open for long at full load: processor, memory, pictures a second, lost samples, and its sound.

`make bench ARGS="page --minutes 60"` writes it to docs/benchmarks.md (`--rate 12800` where two cores have to do);
`python -m benchmarks.page --minutes 1` prints a short run. It needs Chromium.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import os
import re
import struct
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import psutil
from numpy.typing import NDArray
from playwright.sync_api import sync_playwright
from scipy.signal import resample_poly

from squeal_rig.configuration.files import config_directory
from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.view.sound import Resampler
from tests.graph.domains import private_domain
from tests.graph.observer import Observer
from tests.graph.processes import Child, Processes, parameters
from tests.page.browser import Shown, launched

PATIENCE = 600.0
RATE, SOUND_RATE = 51_200, 48_000  # of the rig at full load, of the sound
NODES = ("friction_estimator", "stability", "squeal_detector", "view")
#: After the start, until everything is compiled and the map is drawn [s].
SETTLING = 20.0
MAP_PATIENCE = 180.0
#: Sound that is kept and compared, at most [min].
COMPARED = 10.0


@dataclass
class Heard:
    """What a client that listens and one that looks have got."""

    pieces: list[tuple[int, int, NDArray[np.float32]]] = field(default_factory=list)
    frames: list[int] = field(default_factory=lambda: [0, 0])
    ending: threading.Event = field(default_factory=threading.Event)

    async def _client(self, url: str, number: int) -> None:
        kept = COMPARED * 60.0 * 100.0
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{url}/ws") as socket:
            if number == 0:
                await socket.send_str(json.dumps({"sound": SOUND_RATE}))
            async for message in socket:
                if self.ending.is_set():
                    return
                data = message.data
                (size,) = struct.unpack_from("<I", data)
                head = json.loads(data[4 : 4 + size])
                self.frames[number] += head["kind"] == "frame"
                if head["kind"] == "sound" and len(self.pieces) < kept:
                    self.pieces.append((head["origin"], head["first"], np.frombuffer(data, "<f4", offset=4 + size)))

    def run(self, url: str) -> None:
        """Be both clients until the end is set."""

        async def both() -> None:
            await asyncio.gather(self._client(url, 0), self._client(url, 1))

        asyncio.run(both())


@dataclass
class Shares:
    """Processor and memory of processes over some time."""

    nodes: dict[str, Child]
    browser: list[psutil.Process]
    begun: float = field(default_factory=time.monotonic)
    cpu: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.cpu = self._cpu()

    def _cpu(self) -> dict[str, float]:
        found = {name: node.cpu_seconds() for name, node in self.nodes.items()}
        return {**found, "chromium": sum(sum(p.cpu_times()[:2]) for p in self.browser if p.is_running())}

    def shares(self) -> dict[str, float]:
        """Name -> share of one core since the beginning."""
        spent = time.monotonic() - self.begun
        return {name: (cpu - self.cpu[name]) / spent for name, cpu in self._cpu().items()}


def _browser_processes() -> list[psutil.Process]:
    return [p for p in psutil.Process().children(recursive=True) if "chrom" in p.name().lower()]


def _heap(shown: Shown) -> float:
    """Memory of the page's script [MB], after rubbish was collected."""
    session = shown.context.new_cdp_session(shown.tab)
    session.send("HeapProfiler.collectGarbage")
    return float(session.send("Runtime.getHeapUsage")["usedSize"]) / 1e6


def compared(heard: Heard, bag: Path, rate: int) -> tuple[int, int, int, int, int]:
    """Samples of sound received, compared with the bag's resampled offline, and equal; streams and gaps in them.

    A stream begins anew where the page has lost samples; where the bag has, the rest of a stream is not compared.
    """
    blocks = (samples_from_cdr(m.data).samples for m in Bag(bag).messages(["/daq/samples"]))
    columns = [(block["seq"].copy(), block["x"].copy()) for block in blocks]  # the other columns of an hour are 15 GB
    seq, x = (np.concatenate(column) for column in zip(*columns, strict=True))
    design = Resampler(rate, SOUND_RATE)
    received = usable = equal = gaps = 0
    origins = sorted({piece[0] for piece in heard.pieces})
    for origin in origins:
        mine = [piece for piece in heard.pieces if piece[0] == origin]
        received += sum(len(piece[2]) for piece in mine)
        gaps += sum(a[1] + len(a[2]) != b[1] for a, b in itertools.pairwise(mine))
        found = np.flatnonzero(seq == origin)
        if not len(found):
            continue
        # What the last outputs need, and no more.
        last = mine[-1][1] + len(mine[-1][2])
        x_here = x[found[0] :][: last * design.down // design.up + rate]
        holes = np.flatnonzero(np.diff(seq[found[0] :][: len(x_here)].astype(np.int64)) != 1)
        if len(holes):
            x_here = x_here[: holes[0] + 1]
        offline = resample_poly(1e6 * x_here, design.up, design.down).astype(np.float32)
        whole = (len(x_here) - rate // 10) * design.up // design.down  # what the filter sees behind the end is not ours
        for _, first, sound in mine:
            if first + len(sound) <= whole:
                usable += len(sound)
                equal += int(np.count_nonzero(offline[first : first + len(sound)] == sound))
    return received, usable, equal, len(origins), gaps


def lost_samples(bag: Path, rate: int) -> tuple[int, int, str]:
    """Blocks in the bag, samples missing between them, and when that was: minutes since sample 0."""
    expected, blocks, lost = None, 0, 0
    minutes: dict[str, int] = {}
    for message in Bag(bag).messages(["/daq/samples"]):
        seq = samples_from_cdr(message.data).samples["seq"]
        if expected is not None and (missing := (int(seq[0]) - expected) % 2**32):
            lost += missing
            minute = f"{expected / rate / 60.0:.0f}"
            minutes[minute] = minutes.get(minute, 0) + missing
        expected, blocks = (int(seq[-1]) + 1) % 2**32, blocks + 1
    when = ", ".join(f"{missing} at {minute} min" for minute, missing in minutes.items())
    return blocks, lost, f" ({when})" if when else ""


def measured(minutes: float, pictures: Path | None = None, rate: int = RATE) -> str:
    """Run everything that long; the text of docs/benchmarks.md. `pictures`: a folder for a picture of the page."""
    loads = [os.getloadavg()[0]]
    with private_domain() as domain, tempfile.TemporaryDirectory(prefix="squeal_rig_page_") as name:
        folder = Path(name)
        (folder / "logs").mkdir()
        processes, observer = Processes(domain, folder / "logs"), Observer(domain)
        try:
            return _measured(processes, observer, folder / "long_run", minutes, pictures, loads, rate)
        finally:
            processes.end_all()
            observer.close()


def _measured(
    processes: Processes,
    observer: Any,
    bag: Path,
    minutes: float,
    pictures: Path | None,
    loads: list[float],
    rate: int,
) -> str:
    files = ["--params-file", str(config_directory() / "rig.yaml")]
    nodes = {name: processes.node(name, *files) for name in NODES}
    # It squeals all the time, which is what the supervisor would end.
    nodes["supervisor"] = processes.node("supervisor", *files, *parameters(squeal_duration=1e6))
    nodes["page"] = page = processes.node("page", *files, *parameters(port=0, control=True))
    observer.wait_for(lambda: "http://" in page.errors or not page.running, "the page's address", PATIENCE)
    url = re.search(r"http://\S+?(?=/)", page.errors)[0]  # type: ignore[index]
    # A short relative folder: the page shows it, and so does its picture.
    nodes["recorder"] = processes.node("recorder", *files, *parameters(directory=bag.name), cwd=bag.parent)
    nodes["simulator"] = processes.node("simulator", *files, *parameters(supervisor_required=True, sample_rate=rate))
    observer.wait_for(lambda: observer.state() == "active", "an active rig", PATIENCE)
    observer.set({"preload": 300.0, "k1": 6e7, "k2": 6e7, "mu0": 0.26}, atomically=True)
    heard = Heard()
    with sync_playwright() as playwright:
        browser = launched(playwright)
        shown = Shown(browser, url)
        asked = time.monotonic()  # it is computed while others have nothing to do: a busy machine may not come to it
        while not (drawn := shown.tab.evaluate("Boolean(page.map() && page.map().rows)")):
            if time.monotonic() - asked > MAP_PATIENCE:
                break
            shown.tab.wait_for_timeout(500)
        mapped = f"drawn {time.monotonic() - asked:.0f} s" if drawn else f"not drawn within {MAP_PATIENCE:.0f} s"
        observer.trigger("impact")
        clients = threading.Thread(target=heard.run, args=(url,), daemon=True)
        clients.start()
        shown.tab.wait_for_timeout(1000.0 * SETTLING)
        if pictures is not None:
            shown.tab.screenshot(path=pictures / "page.png", full_page=True)
        memory, heap = [page.memory()], [_heap(shown)]
        shares, frames = Shares(nodes, _browser_processes()), [shown.tab.evaluate("page.frames()"), *heard.frames]
        begun = time.monotonic()
        for _ in range(2):
            shown.tab.wait_for_timeout(30_000.0 * minutes)
            memory.append(page.memory())
            heap.append(_heap(shown))
            loads.append(os.getloadavg()[0])
        spent, cores = time.monotonic() - begun, shares.shares()
        rates = [
            (now - before) / spent
            for now, before in zip([shown.tab.evaluate("page.frames()"), *heard.frames], frames, strict=True)
        ]
        troubles = shown.troubles
        heard.ending.set()
        clients.join(10.0)
        browser.close()
    nodes["simulator"].end()
    nodes["recorder"].end()
    blocks, lost, when = lost_samples(bag, rate)
    received, usable, equal, streams, gaps = compared(heard, bag, rate)
    if not usable:
        raise SystemExit(f"{received} samples of sound were received, and none can be compared with the bag")
    table = "\n".join(f"| {name} | {100.0 * share:.0f}% |" for name, share in sorted(cores.items()))
    resident, script, load = (", ".join(f"{value:.1f}" for value in values) for values in (memory, heap, loads))
    return f"""{minutes:g} min at {rate / 1e3:g} kHz, squealing, all nodes and the recorder; three clients:
Chromium that draws, one that listens, one that takes pictures. Load of the machine (1 min average) before, in the
middle, after: {load} ({os.cpu_count()} cores).

| process | share of a core |
|---|---|
{table}

Pictures a second: Chromium {rates[0]:.1f}, the others {rates[1]:.1f} and {rates[2]:.1f}.
Memory at start, middle, end: node `page` {resident} MB, the script in the browser {script} MB.
The recorder has {blocks} blocks; samples lost: {lost}{when}. The operating map was {mapped} after the page was opened.
Sound: {received} samples received ({received / SOUND_RATE:.0f} s); of {usable} compared with the bag resampled offline
{equal} are equal; streams: {streams} (one where nothing was lost on the way), gaps in them: {gaps}.
Errors in the browser: {"; ".join(troubles) or "none"}.
"""


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--rate", type=int, default=RATE, help="sample rate of the rig [Hz]")
    asked = parser.parse_args()
    sys.stdout.write(measured(asked.minutes, asked.pictures, asked.rate))
    return 0


if __name__ == "__main__":
    sys.exit(main())
