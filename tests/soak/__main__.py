"""Runs the soak: `python -m tests.soak --out soak --minutes 10 --seed 1`; exit code 1 where something was found."""

import argparse
import csv
import importlib.util
import json
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from squeal_rig.configuration.files import config_directory
from squeal_rig.graph import qos
from squeal_rig.graph.interfaces import RECORDING_DEPTH
from squeal_rig.instruments.channels import DAQ_RECORD, FRICTION_SAMPLE_RECORD, TRUTH_RECORD
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.warm_up import warm_up
from squeal_rig.recording import samples_from_cdr
from tests.graph.domains import private_domain
from tests.graph.observer import Observer
from tests.graph.processes import Processes, parameters
from tests.graph.statuses import health_of, status_of

from .bags import BagChecks
from .slopes import faults_of

_RIG_NODES = ("rig", "supervisor", "friction_estimator", "stability", "squeal_detector", "recorder")
_HAS_PAGE = importlib.util.find_spec("aiohttp") is not None  # the extra [page]
_NODES = (*_RIG_NODES, "view", "page") if _HAS_PAGE else _RIG_NODES
_OWN = {
    "rig": {"supervisor_required": True},
    "supervisor": {"nodes": [name for name in _RIG_NODES if name != "supervisor"]},
    "recorder": {"max_file_duration": 60.0},
}
_OPERATING_POINT = {"preload": 50.0, "belt_speed": 1.0}
_KILLS = 20  # in a run of any length
_RECOVERY = 90.0  # s from the start of a node to its health, on a loaded machine
_PERIOD = 1.0  # s between two looks
_PIECES = 240  # of the run, of which the latency is drawn
_WATCHDOG = "emergency stop from outside: the rig's process has been silent"
_BLOCK = 0.01  # s
# What a node's queues of blocks hold at most [MB]: of the rig, the truth and the friction of each sample.
_SAMPLE = DAQ_RECORD.itemsize + TRUTH_RECORD.itemsize + FRICTION_SAMPLE_RECORD.itemsize
_BLOCK_SIZE = RigSettings().block_size * _SAMPLE / 2**20  # [MB]
# s for an answer of the rig, which its watchdog may just have ended; and for one that is asked for again.
_PATIENCE, _SHORTLY = 60.0, 10.0


@dataclass
class Life:
    """One process of a node, from start to end: what it took every second."""

    name: str
    child: object
    number: int
    begin: float
    bag: Path | None = None
    times: list = field(default_factory=list)
    memory: list = field(default_factory=list)
    handles: list = field(default_factory=list)
    ending: str = "ended"


def is_well(name, told):
    """Whether a node's health says that it is back; a recorder goes on telling what was lost on the way to it."""
    return told[0] == 0 or (name == "recorder" and told[0] == 1 and told[2]["state"].startswith("recording"))


def queues_of(name):
    """What a node's queues of blocks hold at most [MB]."""
    return (RECORDING_DEPTH if name == "recorder" else qos.BLOCKS_IN.depth) * _BLOCK_SIZE


class Soak:
    """The rig, its nodes and what happens to them."""

    def __init__(self, processes, observer, out, seed):
        self.processes, self.observer, self.out = processes, observer, out
        self.random = random.Random(seed)
        self.lives, self.events, self.faults = [], [], []
        self.running, self.recoveries, self.rows = {}, [], []
        self.bags = BagChecks()
        self.health = observer.follow("/diagnostics", depth=200)
        self.states = observer.follow("supervisor/state", depth=20)
        self.delays, self.seen_lost, self._next = [], 0, None
        self.port, self.watcher = 0, None
        if _HAS_PAGE:
            from .watcher import Watcher, free_port

            self.port = free_port()
            self.watcher = Watcher(self.port)
        # Written as it comes: a run of hours that is ended leaves what it saw.
        self._table = (out / "soak.csv").open("w", newline="", encoding="utf-8", buffering=1)
        self._csv = csv.writer(self._table)
        self._csv.writerow(("node", "life", "t [s]", "memory [MB]", "handles"))
        observer.listen("daq/samples", self._take, raw=True)
        self.begin = time.monotonic()

    @property
    def now(self):
        return time.monotonic() - self.begin

    def _take(self, data):
        arrived = time.time_ns()
        block = samples_from_cdr(data)
        seq = block.samples["seq"]
        self.delays.append((arrived - block.stamp_ns) / 1e9 - _BLOCK)
        if self._next is not None and 0 < (ahead := int(seq[0]) - self._next) < 2**31:
            self.seen_lost += ahead
        self._next = int(seq[-1]) + 1

    def fault(self, sentence):
        """Note a fault, and tell it at once."""
        self.faults.append(sentence)
        sys.stderr.write(f"{self.now:.0f} s: {sentence}\n")

    # --- nodes

    def start(self, name):
        options, bag = dict(_OWN.get(name, {})), None
        if name == "recorder":
            bag = options["directory"] = self.out / "bags" / f"{len(self.lives):03d}"
        if name == "page":
            options["port"] = self.port
        if name == "supervisor":
            self.states.clear()  # those of the one before
        files = ("--params-file", config_directory() / "rig.yaml")
        child = self.processes.node(name, *files, *parameters(**options), cwd=self.out)
        life = Life(name, child, len(self.lives), self.now, bag)
        self.lives.append(life)
        self.running[name] = life
        self.health.clear()
        return life

    def recover(self, life):
        """Wait until a node says that it is well, and the rig moves; what docs/supervisor.md says is done for that."""
        begin = time.monotonic()
        while time.monotonic() - begin < _RECOVERY and life.ending != "died":
            self.observer.spin(0.2)
            self.look()
            if self.running[life.name] is not life:  # its watchdog has ended the rig meanwhile
                begin, life = time.monotonic(), self.running[life.name]
            told = health_of(self.health, life.name)
            if told is not None and self.is_stopped():
                self.release()
            elif told is not None and is_well(life.name, told):
                self.recoveries.append((life.name, time.monotonic() - begin))
                return
        told = health_of(self.health, life.name)
        self.fault(f"{life.name} did not come back within {_RECOVERY:g} s: {told or life.child.errors[-300:]}")

    def told_by_supervisor(self):
        """(level, sentence) of the supervisor, as it has told last."""
        found = status_of(self.states[-1], "supervisor") if self.states else None
        return (found[2]["level"], found[1]) if found else ("ok", "")

    def is_stopped(self):
        """Whether the rig stands, or is on its way to it, because the supervisor or itself has said so."""
        rig = health_of(self.health, "rig")
        return self.told_by_supervisor()[0] not in ("ok", "warn") or (rig is not None and rig[0] == 2)

    def release(self):
        """One try of the procedure after a trip; who is not back yet refuses it."""
        try:
            if self.told_by_supervisor()[0] not in ("ok", "warn"):
                reason = {"reset_reason": "the soak killed a node"}
                self.observer.set(reason, node="supervisor", timeout=_SHORTLY)
                if not self.observer.trigger("reset", rig="supervisor", timeout=_SHORTLY)[0]:
                    return
            if self.observer.trigger("reset", timeout=_SHORTLY)[0]:
                self.observer.set(_OPERATING_POINT, timeout=_SHORTLY)
        except AssertionError:  # no answer yet
            return

    def kill(self):
        """End one node, the hard way or by a signal, and start it again."""
        name = self.random.choice([name for name in _NODES if self.running[name].child.running] or _NODES)
        life = self.running[name]
        number = self.random.choice((signal.SIGKILL, signal.SIGTERM, signal.SIGINT))
        life.ending = number.name
        self.events.append((self.now, f"{number.name} {life.name}"))
        life.child.send(number)
        try:
            code = life.child.wait(60.0)
        except subprocess.TimeoutExpired:
            self.fault(f"{life.name} still runs 60 s after {number.name}")
            life.child.kill()
        else:
            if number != signal.SIGKILL and code != 0:
                self.fault(f"{life.name} ended with exit code {code} after {number.name}")
        self.recover(self.start(life.name))
        if life.bag is not None:
            self.bags.check(life.bag, killed=number == signal.SIGKILL)

    # --- what happens

    def act(self):
        """One change of parameters, or a hit, or a reset."""
        pick = self.random.random()
        try:
            if pick < 0.5:
                values = {"preload": self.random.uniform(20.0, 300.0), "belt_speed": self.random.uniform(1.0, 4.0)}
                what = self.observer.set(values, timeout=_PATIENCE)
            else:
                what = self.observer.trigger("impact" if pick < 0.85 else "reset", timeout=_PATIENCE)
        except AssertionError as error:
            what = f"no answer: {error}"
            if self.running["rig"].child.running:  # else `look` tells why it has ended
                self.fault(f"the rig did not answer: {error}")
        self.events.append((self.now, str(what)))

    def look(self):
        """Note what every node takes, once a second."""
        if self.rows and self.now - self.rows[-1][0] < _PERIOD:
            return
        delays, self.delays = self.delays, []
        late = np.percentile(delays, (50.0, 99.0)) * 1e3 if delays else (float("nan"), float("nan"))
        row = [self.now, *late, self.seen_lost]
        for name, life in self.running.items():
            if life.child.running:
                pid = life.child.process.pid
                try:
                    memory, handles = life.child.memory(), len(list(Path(f"/proc/{pid}/fd").iterdir()))
                except (OSError, TypeError):  # it has just ended
                    continue
                life.times.append(self.now)
                life.memory.append(memory)
                life.handles.append(handles)
                self._csv.writerow((name, life.number, f"{self.now:.6g}", f"{memory:.6g}", handles))
            elif life.ending == "ended":
                life.ending = "died"
                if name == "rig" and _WATCHDOG in life.child.errors:
                    # As it should on a machine that lets the rig wait for so long; released as after every stop.
                    self.events.append((self.now, _WATCHDOG))
                    self.start(name)
                else:
                    self.fault(f"{name} ended by itself with exit code {life.child.wait()}")
        self.rows.append(row)

    def run(self, seconds):
        for life in [self.start(name) for name in _NODES]:
            self.recover(life)
        self.observer.wait_for_listeners("daq/samples", len(_NODES))
        self.recoveries.clear()
        begin = self.now
        end = begin + seconds
        kills = iter(sorted(begin + seconds * (k + self.random.random()) / _KILLS for k in range(_KILLS)))
        next_kill, next_action = next(kills), begin
        campaign = None
        while self.now < end:
            self.observer.spin(0.2)
            self.look()
            if self.is_stopped():
                self.events.append((self.now, f"trip: {self.told_by_supervisor()[1]}"))
                self.recover(self.running["rig"])
            if self.now > next_action:
                self.act()
                next_action = self.now + self.random.uniform(1.0, 6.0)
            if self.now > next_kill:
                self.kill()
                next_kill = next(kills, float("inf"))
            if campaign is None and self.now > begin + 0.25 * seconds:
                campaign = self.start_campaign()
        if campaign is None or campaign.wait(600.0) != 0:
            self.fault(f"the campaign beside: {campaign and campaign.errors[-300:]}")
        if self.watcher is not None:
            self.watcher.close()
        for life in [self.running["recorder"], *self.running.values()]:
            if life.child.running:
                life.ending = "SIGINT"
                life.child.end()

    def start_campaign(self):
        """A campaign by the engine, beside all that."""
        plan = config_directory() / "campaigns" / "smoke.yaml"
        return self.processes.command("campaign", "run", plan, "--out", self.out / "campaign", "--workers", "0")

    # --- judgement

    def judge(self):
        pages = sum(life.name == "page" for life in self.lives)
        if self.watcher is not None and self.watcher.connections < pages:
            self.faults.append(f"a browser came to {self.watcher.connections} of {pages} lives of the page")
        for life in self.lives:
            for kind, values in (("memory", life.memory), ("handles", life.handles)):
                if len(life.times) >= 60:
                    queues = queues_of(life.name) if kind == "memory" else 0.0
                    self.faults += faults_of(f"{life.name} from {life.begin:.0f} s", kind, life.times, values, queues)
        self.bags.check(self.running["recorder"].bag, killed=False)
        self.faults += self.bags.faults()
        return self.faults

    def write(self):
        self._table.close()
        slowest = max((seconds for _, seconds in self.recoveries), default=0.0)
        late = np.array([row[2] for row in self.rows])
        verdict = {
            "faults": self.faults,
            "seconds": round(self.now),
            "kills": sum(what.startswith("SIG") for _, what in self.events),
            "trips between kills": sum(what.startswith("trip") for _, what in self.events),
            "rigs ended by their watchdog": sum(what == _WATCHDOG for _, what in self.events),
            "recovered from these": len(self.recoveries),
            "slowest recovery [s]": round(slowest, 1),
            "actions": sum(not what.startswith(("SIG", "trip", _WATCHDOG)) for _, what in self.events),
            "latency p99, median over the seconds [ms]": round(float(np.nanmedian(late)), 2),
            "latency p99, worst second [ms]": round(float(np.nanmax(late)), 1),
            "samples that the observer missed": self.seen_lost,
        }
        if self.watcher is not None:
            verdict["messages from the page"] = self.watcher.messages
        (self.out / "soak.json").write_text(json.dumps(verdict, indent=2) + "\n", encoding="utf-8")
        self.draw()
        return verdict

    def draw(self):
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(4, 1, figsize=(11, 11), sharex=True, layout="constrained")
        for color, name in zip(plt.rcParams["axes.prop_cycle"].by_key()["color"], _NODES, strict=False):
            for number, life in enumerate(life for life in self.lives if life.name == name):
                label = name if number == 0 else None
                axes[0].plot(life.times, life.memory, color=color, label=label)
                axes[1].plot(life.times, life.handles, color=color, label=label)
        rows = np.array(self.rows)
        pieces = np.array_split(rows[np.isfinite(rows).all(axis=1)], min(len(rows), _PIECES))
        pieces = [piece for piece in pieces if len(piece)]
        times = [piece[:, 0].mean() for piece in pieces]
        axes[2].semilogy(times, [np.median(piece[:, 1]) for piece in pieces], label="median")
        axes[2].semilogy(times, [piece[:, 2].max() for piece in pieces], label="p99 of the worst second")
        axes[3].plot(rows[:, 0], rows[:, 3])
        labels = ("memory [MB]", "open files", "block to observer,\nlatency [ms]", "samples the observer\nmissed")
        for axis, label in zip(axes, labels, strict=True):
            axis.set_ylabel(label)
            axis.grid(alpha=0.4)
            for at, what in self.events:
                if what.startswith("SIG"):
                    axis.axvline(at, color="0.6", lw=0.7, ls=":")
        axes[0].legend(ncols=len(_NODES), fontsize="small")
        axes[2].legend(fontsize="small")
        axes[0].set_title("Full load; dotted: a node was killed or ended, and started again")
        axes[-1].set_xlabel("time [s]")
        figure.savefig(self.out / "soak.png", dpi=110)


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.soak")
    parser.add_argument("--out", type=Path, default=Path("soak"))
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--hours", type=float)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    seconds = options.hours * 3600.0 if options.hours else options.minutes * 60.0
    out = options.out.resolve()
    for folder in ("bags", "campaign"):
        shutil.rmtree(out / folder, ignore_errors=True)
    warm_up()  # else the nodes compile all at once, each for itself
    (out / "logs").mkdir(parents=True, exist_ok=True)
    with private_domain() as domain:
        processes, observer = Processes(domain, out / "logs"), Observer(domain)
        soak = Soak(processes, observer, out, options.seed)
        try:
            soak.run(seconds)
        except Exception as error:
            if not soak.rows:
                raise
            # What it has seen by then is judged all the same.
            soak.fault(f"the run was broken off: {type(error).__name__}: {error}")
        finally:
            observer.close()
            processes.end_all()
        soak.judge()
        verdict = soak.write()
    if not verdict["faults"]:  # else somebody will want to look into them
        shutil.rmtree(out / "bags", ignore_errors=True)
    sys.stdout.write(json.dumps(verdict, indent=2) + "\n")
    return 1 if verdict["faults"] else 0


if __name__ == "__main__":
    sys.exit(main())
