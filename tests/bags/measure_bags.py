"""Measures recording, replay, export and verification at full load; prints a Markdown report.

Run: `python -m tests.bags.measure_bags [SECONDS] [FOLDER]`. SECONDS is the length of the recording (600 for the
numbers in docs/benchmarks_bags.md), FOLDER where the bags go (a temporary one without).
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from squeal_rig.recording import Bag, BagWriter, installed_schema, samples_from_cdr
from squeal_rig.recording.verify import verify
from tests.graph.domains import private_domain
from tests.graph.observer import Observer
from tests.graph.processes import Processes, parameters
from tests.graph.statuses import health_of

from .full_load import CLOUDS, ROWS, SMALL, layout, payload, published, start_load

_TOPIC = "/daq/samples"
_TYPE = "sensor_msgs/msg/PointCloud2"


def say(line=""):
    """Print at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


# --- write throughput


def _ours(path, payloads, compression):
    with BagWriter(path, compression=compression) as writer:
        handle = writer.add_topic(_TOPIC, _TYPE)
        for number, data in enumerate(payloads):
            writer.write(handle, data, number, number)


def _bare(path, payloads, compression):
    from mcap.writer import CompressionType, Writer

    kind = {"zstd": CompressionType.ZSTD, "none": CompressionType.NONE}[compression]
    path.mkdir()
    with open(path / "bare.mcap", "wb") as stream:
        writer = Writer(stream, chunk_size=1 << 20, compression=kind)
        writer.start("ros2", "bare")
        schema = writer.register_schema(_TYPE, "ros2msg", installed_schema(_TYPE).text.encode())
        channel = writer.register_channel(_TOPIC, "cdr", schema)
        for number, data in enumerate(payloads):
            writer.add_message(channel, number, data, number, number)
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())


def _plain(path, payloads, _compression):
    path.mkdir()
    with open(path / "plain.bin", "wb", buffering=0) as stream:
        for data in payloads:
            stream.write(data)
        os.fsync(stream.fileno())


def throughput(folder, count=4000, rounds=3):
    """The same payloads through our writer, the bare one of `mcap`, and as plain bytes; by turns, the best of each."""
    payloads = [payload(_TOPIC, number) for number in range(count)]
    size = sum(map(len, payloads)) / 1e6
    say(f"\n## Write throughput\n\n{size:.0f} MB of full-load blocks from memory to disk, synced; best of {rounds}.\n")
    say("| writer | zstd [MB/s] | no compression [MB/s] |\n|---|---|---|")
    best = {}
    for turn in range(rounds):
        for compression in ("zstd", "none"):
            for name, write in (("ours", _ours), ("mcap", _bare), ("plain bytes", _plain)):
                path = folder / f"{name.replace(' ', '_')}_{compression}_{turn}"
                began = time.perf_counter()
                write(path, payloads, compression)
                took = time.perf_counter() - began
                best[name, compression] = max(best.get((name, compression), 0.0), size / took)
                subprocess.run(["rm", "-rf", path], check=True)
    for name in ("ours", "mcap", "plain bytes"):
        say(f"| {name} | {best[name, 'zstd']:.0f} | {best[name, 'none']:.0f} |")
    ratio = {c: best["ours", c] / best["mcap", c] for c in ("zstd", "none")}
    disk = max(best["plain bytes", c] for c in ("zstd", "none"))
    say(f"\nOurs against `mcap`: {ratio['zstd']:.2f} with zstd, {ratio['none']:.2f} without.")
    say(f"Share of the disk's own speed without compression: {best['ours', 'none'] / disk:.2f}.")


# --- full load


class Watch:
    """CPU time and memory of a process, once a second."""

    def __init__(self, child):
        self._child = child
        self.memory, self._started = [], (time.monotonic(), child.cpu_seconds())
        self._last = 0.0

    def look(self):
        """Take a value if one is due."""
        if time.monotonic() - self._last >= 1.0:
            self._last = time.monotonic()
            self.memory.append(self._child.memory())

    def share(self):
        """CPU time over time since the start."""
        return (self._child.cpu_seconds() - self._started[1]) / (time.monotonic() - self._started[0])


def full_load(folder, seconds, domain):
    """Record a full rig's load; returns the bag."""
    processes, observer = Processes(domain, folder), Observer(domain)
    try:
        health = observer.follow("/diagnostics")
        recorder = processes.node("recorder", *parameters(directory=folder / "full"))
        load = start_load(processes, folder / "load.txt", seconds, listeners=1)
        observer.wait_for(lambda: published(folder / "load.txt")[0] > 100, "published blocks")
        watch = Watch(recorder)
        while load.running:
            observer.spin(0.2)
            watch.look()
        cpu, lost = watch.share(), health_of(health, "recorder")[2]["lost messages"]
        code, _ = recorder.end()
    finally:
        observer.close()
        processes.end_all()
    bag = Bag(folder / "full")
    blocks = published(folder / "load.txt")[0]
    recorded = {topic: bag.topics[topic].message_count for topic in (*CLOUDS, *SMALL)}
    size = sum(path.stat().st_size for path in bag.files) / 1e6
    memory = watch.memory
    tenth = max(1, len(memory) // 10)
    say(f"\n## Full-load recording, {seconds:g} s\n")
    say(f"- {blocks} blocks published on each of {len(recorded)} topics; recorded: {json.dumps(recorded)}")
    others = {t: bag.topics[t].message_count for t in ("/rosout", "/parameter_events", "/diagnostics")}
    say(f"- beside them: {json.dumps(others)}")
    missing = sum(blocks - count for count in recorded.values())
    say(f"- messages missing: {missing}; lost as the middleware says: {lost}; exit code {code}")
    say(f"- {size:.0f} MB on disk, {size / seconds:.1f} MB/s; CPU of the recorder {100 * cpu:.0f} % of one core")
    first, last = float(np.mean(memory[tenth : 2 * tenth])), float(np.mean(memory[-tenth:]))
    say(f"- memory of the recorder: {first:.1f} MB early, {last:.1f} MB late, {max(memory):.1f} MB at most")
    return bag


def spacing(bag, folder, domain, seconds):
    """Replay the first seconds at rate 1 into a second recording; the error of the spacing."""
    from squeal_rig.recording.rewrite import cut

    cut(bag.path, folder / "piece", 0.0, min(seconds, bag.duration))
    topics = [*CLOUDS, *SMALL]
    logs = folder / "spacing"
    logs.mkdir()
    processes = Processes(domain, logs)
    try:
        recorder = processes.node("recorder", *parameters(directory=folder / "again", topics=topics))
        settings = parameters(bag=folder / "piece", topics=topics, wait_for_subscribers=15.0)
        player = processes.node("player", *settings)
        watch = Watch(player)
        while player.running:
            share = watch.share()
            time.sleep(0.2)
        recorder.end()
    finally:
        processes.end_all()
    first, second = Bag(folder / "piece"), Bag(folder / "again")
    before = np.sort([m.log_time for m in first.messages([*CLOUDS, *SMALL])])
    after = np.sort([m.publish_time for m in second.messages()])
    say(f"\n## Replay, {first.duration:.0f} s of full load at rate 1\n")
    say(f"- {len(before)} messages played, {len(after)} recorded again")
    error = np.abs(np.diff(after) - np.diff(before[: len(after)])) * 1e-6
    p50, p99, p999 = np.percentile(error, [50, 99, 99.9])
    say(
        f"- spacing error: p50 {p50:.3f} ms, p99 {p99:.3f} ms, p99.9 {p999:.3f} ms; CPU {100 * share:.0f} % of one core"
    )


# --- reading


def timed(folder, code):
    """Run code in a process of its own; (seconds, peak memory [MB])."""
    wrapped = (
        "import time\nbegan = time.perf_counter()\n"
        + code
        # not ru_maxrss, which a child inherits from its parent
        + "\npeak = open('/proc/self/status').read().split('VmHWM:')[1].split()[0]"
        + "\nprint(time.perf_counter() - began, int(peak) / 1024)"
    )
    out = subprocess.run([sys.executable, "-c", wrapped], check=True, capture_output=True, text=True, cwd=folder)
    took, peak = out.stdout.split()[-2:]
    return float(took), float(peak)


def reading(bag, folder):
    """Export to Parquet, verification: time, size, peak memory; the samples loaded back against the published ones."""
    import pyarrow.parquet as pq

    say(f"\n## Reading the {bag.duration:.0f} s bag\n")
    bare = timed(folder, "import numpy, pyarrow.parquet")[1]
    code = f"from squeal_rig.samples.export import export_bag\nexport_bag({str(bag.path)!r}, 'parquet', 'parquet')"
    took, peak = timed(folder, code)
    files = sorted((folder / "parquet").iterdir())
    size = sum(path.stat().st_size for path in files) / 1e6
    say(
        f"- export of all samples to Parquet: {took:.1f} s ({bag.duration / took:.0f} times real time), {size:.0f} MB,"
        f" peak memory {peak:.0f} MB (of it {bare:.0f} MB for numpy and pyarrow alone)"
    )
    rows, equal = 0, True
    for topic in CLOUDS:
        file = pq.ParquetFile(folder / "parquet" / f"{topic.strip('/').replace('/', '_')}.parquet")
        for batch in file.iter_batches(ROWS * 100):
            columns = {name: batch.column(name).to_numpy() for name in layout(topic).names}
            for at in range(0, batch.num_rows, ROWS):
                number = int(columns["seq"][at]) // ROWS
                sent = samples_from_cdr(payload(topic, number)).samples
                equal &= all(columns[n][at : at + ROWS].tobytes() == sent[n].tobytes() for n in columns)
                rows += ROWS
    say(
        f"- loaded back: {rows} rows, {'every field equal bit for bit' if equal else 'NOT EQUAL'} to what was published"
    )
    took, peak = timed(
        folder, f"from squeal_rig.recording.verify import verify\nassert verify({str(bag.path)!r}).sound"
    )
    say(f"- verify: {took:.1f} s ({bag.duration / took:.0f} times real time), peak memory {peak:.0f} MB")
    code = f"from squeal_rig.recording.recover import recover\nrecover({str(bag.files[0])!r}, 'recovered')"
    took, peak = timed(folder, code)
    say(f"- recover: {took:.1f} s ({bag.duration / took:.0f} times real time), peak memory {peak:.0f} MB")


def measure(seconds, folder, domain):
    """Everything, in order."""
    load = os.getloadavg()[0]
    say(f"# Bags, measured\n\n{os.cpu_count()} cores, of which others took some: load average {load:.1f} before.")
    say("Messages have the size and rate of 51.2 kHz, all channels.")
    throughput(folder)
    bag = full_load(folder, seconds, domain)
    spacing(bag, folder, domain, 30.0)
    reading(bag, folder)
    verdict = verify(bag.path)
    say(f"- {'sound' if verdict.sound else verdict.findings}")


if __name__ == "__main__":
    length = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    with private_domain() as number, tempfile.TemporaryDirectory(prefix="bags_") as temporary:
        chosen = Path(sys.argv[2] if len(sys.argv) > 2 else temporary).absolute()
        chosen.mkdir(parents=True, exist_ok=True)
        measure(length, chosen, number)
