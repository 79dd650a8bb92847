"""Runs a campaign on the engine: chunk by chunk here, or on a Dask cluster; what is done is never done again."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from squeal_rig.errors import ExperimentError
from squeal_rig.experiments.campaign.measuring import FAILED, Table, measure_chunk
from squeal_rig.experiments.campaign.plans import EVENTS, LEVEL, Campaign
from squeal_rig.experiments.campaign.store import NO_EXTRA, Store, header, journal

# Chunks handed out for each worker: enough that none waits, few enough that memory stays flat.
_AHEAD = 3
# How often results are looked for [s]; and how often workers may die in a row with nothing done.
_LOOK, _MOST_DEATHS = 0.05, 100
# How long a scheduler's first worker is waited for [s]; how often a chunk is given out whose workers die.
_WORKERS_WITHIN, _MOST_AGAIN = 60, 10
# Chunks of this much simulated time [s]: some seconds of work, which is what a worker that dies costs. Following tones
# takes many times what summaries do.
_CHUNK_SECONDS, _LARGEST_CHUNK = {EVENTS: 100.0, LEVEL: 1000.0}, 4000
# Dask looks at what a worker does every 10 ms, for a dashboard that is not there.
_PROFILE = "distributed.worker.profile.enabled"
# Campaigns of less simulated time [s] than this are not worth a cluster.
_SMALL = 2000.0


@dataclass(frozen=True)
class Where:
    """Where chunks are measured: by `workers` processes here (0: in this process; None: as the campaign is worth), or
    by the scheduler at an address.
    """

    workers: int | None = None
    scheduler: str = ""


@dataclass(frozen=True)
class Progress:
    """How far a campaign is: points done and in all, of those measured in this run, time spent in it [s]."""

    done: int
    total: int
    measured: int
    spent: float

    @property
    def left(self) -> float:
        """Time left [s], at the rate so far; inf before the first point."""
        return self.spent * (self.total - self.done) / self.measured if self.measured else float("inf")

    def __str__(self) -> str:
        rate = f", {self.measured / self.spent:.3g} points/s, {self.left:.0f} s left" if self.measured else ""
        return f"{self.done} of {self.total} points{rate}"


def chunk_size(campaign: Campaign) -> int:
    """Points of a chunk."""
    duration = max(campaign.point_duration, 1e-6)
    return max(1, min(_LARGEST_CHUNK, int(_CHUNK_SECONDS[campaign.measure] / duration)))


def start(folder: Path, campaign: Campaign, chunk: int | None = None, live: bool = False) -> Store:
    """A new campaign in a folder."""
    from squeal_rig.recording.provenance import provenance

    facts = {"title": campaign.title, "live": live, "provenance": provenance()}
    return Store.create(folder, campaign, 1 if live else chunk or chunk_size(campaign), facts)


def run_direct(store: Store, where: Where, tell: Callable[[Progress], None]) -> Progress:
    """Measure every chunk that is missing; returns how far it came.

    Raises:
        ExperimentError: a rule of the plan ended it, or there is no cluster.
    """
    campaign = store.campaign
    work = campaign.design.count * campaign.point_duration
    workers = where.workers
    if workers is None:
        workers = 0 if work < _SMALL else os.cpu_count() or 1
    begin, measured = time.monotonic(), 0
    failures = sum(int(entry.get("failed", 0)) for entry in store.done.values())
    done = sum(int(entry["rows"]) for entry in store.done.values())
    progress = Progress(done, campaign.design.count, 0, 0.0)
    store.note("run started", workers=workers, scheduler=where.scheduler, done=done)
    outcome = "done"
    try:
        with _chunks(store, workers, where.scheduler) as results:
            for number, tables in results:
                failed = int(np.sum(tables["points"]["verdict"] == FAILED))
                store.add(number, tables, failed=failed)
                rows = len(tables["points"]["place"])
                done, measured, failures = done + rows, measured + rows, failures + failed
                progress = Progress(done, campaign.design.count, measured, time.monotonic() - begin)
                tell(progress)
                if failures >= campaign.stop.failures:
                    raise ExperimentError(
                        f"{failures} points failed, which ends the plan: stop.failures = {campaign.stop.failures}"
                    )
                if progress.spent > campaign.stop.duration:
                    raise ExperimentError(f"the plan's time of {campaign.stop.duration:g} s is over; resume goes on")
    except BaseException as error:
        outcome = str(error) or type(error).__name__
        raise
    finally:
        store.note("run ended", outcome=outcome, done=done)
    return progress


@contextmanager
def _chunks(store: Store, workers: int, scheduler: str) -> Iterator[Iterator[tuple[int, dict[str, Table]]]]:
    """Measured chunks, as they come."""
    if not workers and not scheduler:
        yield ((number, measure_chunk(store.campaign.text, *store.span(number))) for number in store.missing())
        return
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise ExperimentError(NO_EXTRA) from None
    # A chunk is not to blame for the workers that die while they have it.
    with ExitStack() as stack:
        settings = {"distributed.scheduler.allowed-failures": 1_000_000, _PROFILE: False}
        stack.enter_context(dask.config.set(settings))
        own, address = None, scheduler
        if not scheduler:
            cluster = LocalCluster(n_workers=0, dashboard_address=None, silence_logs=50)
            stack.callback(cluster.close)
            address = cluster.scheduler_address
            own = _Workers(workers, address)
            stack.callback(own.close)
        try:
            client = stack.enter_context(Client(address, timeout="20s"))
            if own is None:
                client.wait_for_workers(1, timeout=_WORKERS_WITHIN)
        except (OSError, TimeoutError, ValueError, TypeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise ExperimentError(f"no Dask scheduler with a worker answers at {address!r}: {reason}") from None
        yield _from_cluster(store, client, own)


class _Workers:
    """Workers here, each a process; one that dies is replaced, whenever it dies (Dask's own nannies give up a worker
    that dies while it starts).
    """

    def __init__(self, count: int, address: str) -> None:
        self._command = [
            sys.executable, "-m", "distributed.cli.dask_worker", address,
            "--no-nanny", "--nthreads", "1", "--no-dashboard", "--memory-limit", "0", "--death-timeout", "60",
        ]  # fmt: skip
        self._folder = tempfile.TemporaryDirectory(prefix="squeal_rig_")
        self.count, self._deaths = count, 0
        self._processes = [self._started() for _ in range(count)]

    def _started(self) -> subprocess.Popen[bytes]:
        command = [*self._command, "--local-directory", self._folder.name]
        environment = {**os.environ, "DASK_" + _PROFILE.upper().replace(".", "__"): "False"}
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)

    def mend(self) -> None:
        """Replace those that have died."""
        for number, process in enumerate(self._processes):
            if process.poll() is not None:
                self._deaths += 1
                if self._deaths > _MOST_DEATHS:
                    raise ExperimentError(f"workers died {_MOST_DEATHS} times, and no chunk was done in between")
                self._processes[number] = self._started()

    def relieved(self) -> None:
        """A chunk is done: what died before is forgotten."""
        self._deaths = 0

    def close(self) -> None:
        """End all of them."""
        for process in self._processes:
            process.kill()  # what they were at is not needed
        for process in self._processes:
            process.wait()
        self._folder.cleanup()


def _from_cluster(store: Store, client: Any, own: _Workers | None) -> Iterator[tuple[int, dict[str, Table]]]:
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    missing, handed_out = store.missing(), {}
    waiting, again = as_completed(), dict[int, int]()

    def hand_out(number: int | None) -> None:
        if number is not None:
            key = f"squeal-rig-{store.campaign.crc}-{number}-{time.monotonic_ns()}"
            future = client.submit(measure_chunk, store.campaign.text, *store.span(number), key=key, pure=False)
            handed_out[future.key] = number
            waiting.add(future)

    threads = own.count if own is not None else max(1, sum(client.nthreads().values()))
    for _ in range(_AHEAD * threads):
        hand_out(next(missing, None))
    while handed_out:
        if own is not None:
            own.mend()
        done = waiting.next_batch(block=False)
        if not done:
            time.sleep(_LOOK)
        for future in done:
            number = handed_out.pop(future.key)
            try:
                tables = future.result()
            except KilledWorker:  # a scheduler that is not ours gives up sooner
                again[number] = again.get(number, 0) + 1
                if again[number] > _MOST_AGAIN:
                    first, last = store.span(number)
                    raise ExperimentError(
                        f"the workers that were given the points {first} to {last - 1} have died {again[number]} times"
                    ) from None
                hand_out(number)
                continue
            except (CancelledError, OSError):
                raise ExperimentError("the Dask scheduler is gone: resume goes on once there is one") from None
            future.release()
            if own is not None:
                own.relieved()
            yield number, tables
            hand_out(next(missing, None))


def status(folder: Path) -> list[str]:
    """How far the campaign in a folder is, in sentences.

    Raises:
        ExperimentError: there is none.
    """
    campaign, first = header(folder)
    entries = journal(folder)
    done = sum({int(e["chunk"]): int(e["rows"]) for e in entries if e["what"] == "chunk"}.values())
    runs = [e for e in entries if e["what"] in ("run started", "run ended")]
    sentences = [
        f"{campaign.title}: {done} of {campaign.design.count} points, {'live' if first.get('live') else 'direct'}",
        f"runs so far: {sum(e['what'] == 'run started' for e in runs)}",
    ]
    if runs and runs[-1]["what"] == "run started":
        sentences.append("it runs, or was killed: resume tells which")
    elif runs:
        sentences.append(f"it ended: {runs[-1]['outcome']}")
    return sentences
