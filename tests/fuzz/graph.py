"""Messages and requests on the graph: every subscription and service of real nodes, on a domain of their own."""

import json
import os
import re
import signal
import sys
import tempfile
import time
from pathlib import Path

from hypothesis import strategies as st

import squeal_rig
from squeal_rig.catalogue.checking import NODE_PARAMETERS
from squeal_rig.configuration.declared import declarations
from squeal_rig.configuration.files import config_directory
from squeal_rig.errors import SquealRigError
from squeal_rig.instruments.channels import DAQ_CHANNELS, block_from_cdr
from tests.graph.domains import private_domain
from tests.graph.processes import Processes, parameters
from tests.graph.statuses import health_of

from . import Case
from .bags import make_corpus
from .bounded import DEADLINE, die_with_parent
from .records import DESCRIPTION, ODD_FLOATS, ODD_NUMBERS, clouds, heavy_clouds, messages_of, string_cdr
from .yaml_files import bombs, odd_texts

__all__ = ["Tester", "cases", "count", "made", "make_corpus"]

CONSUMERS = ("friction_estimator", "stability", "squeal_detector")
NODES = ("rig", *CONSUMERS, "recorder", "player")
#: Topic -> type of all that somebody of ours subscribes to.
SUBSCRIBED = {
    "/daq/samples": "sensor_msgs/msg/PointCloud2",
    "/truth/samples": "sensor_msgs/msg/PointCloud2",
    "/friction/windows": "sensor_msgs/msg/PointCloud2",
    "/rig/description": "std_msgs/msg/String",
    "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/squeal/state": "diagnostic_msgs/msg/DiagnosticArray",
    "/stability/summary": "diagnostic_msgs/msg/DiagnosticArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/friction/mu": "std_msgs/msg/Float64",
    "/friction/model": "std_msgs/msg/Float64MultiArray",
    "/pad/state": "sensor_msgs/msg/JointState",
    "/contact/wrench": "geometry_msgs/msg/WrenchStamped",
}
TRIGGERS = (
    *("rig/reset", "rig/impact", "rig/zero", "recorder/start", "recorder/stop", "recorder/split", "recorder/snapshot"),
    *("player/pause", "player/resume", "player/step"),
)
_ACTIONS = 30  # of one input
_SHUTDOWNS = (5, 6, 7)  # transitions after which a rig cannot be brought back; the last word, not an input
_ODD_TEXTS = (
    "",
    "x",
    "preload",
    "[/x]",
    "\x1b[31m",
    "a.b",
    "qos_overrides./x",
    "use_sim_time",
    "x" * 3000,
    "\u00e9",
    "/**",
)
_SOURCES = {path.name for path in Path(squeal_rig.__file__).parent.rglob("*.py")}
_FAILURE = re.compile(r"(\w+(?:Error|Exception)): [^\n]*\((\w+\.py), line (\d+)\)")
_GOOD = {"preload": 50.0, "belt_speed": 1.0, "k1": 4e7, "k2": 4e7, "mass": 11.499, "damping_x": 20.0, "damping_y": 20.0}


# --- what is sent


def _names(node):
    known = [name for kind in NODE_PARAMETERS[node] for name in declarations(kind)]
    return st.sampled_from((*known, *known, *_ODD_TEXTS)) if known else st.sampled_from(_ODD_TEXTS)


@st.composite
def _settings(draw, node):
    """(name, number of a type, value) of a parameter: often one at a bound, else of any type there is or is not."""
    name = draw(_names(node))
    known = {name: d for kind in NODE_PARAMETERS[node] for name, d in declarations(kind).items()}
    if name in known and known[name].kind is float and draw(st.booleans()):
        return name, 3, draw(st.sampled_from((known[name].lower, known[name].upper, known[name].default, *ODD_FLOATS)))
    kind = draw(st.sampled_from((0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 200, 255)))
    value = {
        1: st.booleans(),
        2: st.sampled_from((0, 1, -1, 2**63 - 1, -(2**63))),
        3: st.sampled_from(ODD_FLOATS),
        4: st.sampled_from(_ODD_TEXTS),
        5: st.lists(st.integers(0, 255), max_size=3),
        6: st.lists(st.booleans(), max_size=3),
        7: st.lists(st.sampled_from((0, 2**63 - 1)), max_size=3),
        8: st.lists(st.sampled_from(ODD_FLOATS), max_size=3),
        9: st.lists(st.sampled_from(_ODD_TEXTS), max_size=3),
    }.get(kind, st.none())
    return name, kind, draw(value)


def _publications():
    def of(topic):
        kind = SUBSCRIBED[topic]
        data = clouds(topic[1:] if topic[1:] in ("daq/samples", "truth/samples", "friction/windows") else None)
        if topic == "/rig/description":
            data = st.one_of(messages_of(kind), odd_texts(DESCRIPTION).map(string_cdr))
        elif kind != "sensor_msgs/msg/PointCloud2":
            data = messages_of(kind)
        return data.map(lambda data: (f"publish {topic}", data))

    often = ("/daq/samples", "/daq/samples", "/rig/description", "/friction/windows", "/truth/samples")
    return st.sampled_from((*often, *SUBSCRIBED)).flatmap(of)


def _requests():
    """(what is asked of whom, its arguments as JSON)."""
    node = st.sampled_from(NODES)
    lists = node.flatmap(lambda n: st.tuples(st.just(n), st.lists(_settings(n), max_size=3)))
    names = node.flatmap(lambda n: st.tuples(st.just(n), st.lists(_names(n), max_size=4)))
    return st.one_of(
        st.builds(lambda how, a: (f"{how} {a[0]}", a[1]), st.sampled_from(("set", "set", "set_atomically")), lists),
        st.builds(lambda how, a: (f"{how} {a[0]}", a[1]), st.sampled_from(("get", "get_types", "describe")), names),
        st.builds(
            lambda n, depth, p: (f"list {n}", [depth, p]),
            node,
            st.sampled_from((0, 1, 2**64 - 1)),
            st.lists(st.sampled_from(_ODD_TEXTS), max_size=2),
        ),
        st.sampled_from(TRIGGERS).map(lambda name: (f"trigger {name}", None)),
        st.booleans().map(lambda on: ("pause rig", on)),
        st.sampled_from([n for n in (*range(100), 255) if n not in _SHUTDOWNS]).map(
            lambda n: ("transition rig", [n, ""])
        ),
        st.sampled_from((1, 2, 3, 4)).map(lambda n: ("transition rig", [n, ""])),
        st.sampled_from(_ODD_TEXTS).map(lambda label: ("transition rig", [0, label])),
        st.sampled_from(ODD_NUMBERS).map(lambda n: ("clock", [n % 2**32 - 2**31, n % 2**32])),
        lists.map(lambda a: ("event /" + a[0], a[1])),
    ).map(lambda pair: (pair[0], json.dumps(pair[1]).encode()))


def _case(actions):
    places = [f"{place:03d}" for place in range(len(actions))]
    return Case(
        dict(zip(places, (data for _, data in actions), strict=True)),
        dict(zip(places, (name for name, _ in actions), strict=True)),
    )


def count(case):
    """Inputs in a case."""
    return len(case.files)


def made(_corpus):
    """Texts and clouds that stand for more than they are, as messages."""
    for text in bombs().values():
        yield _case([("publish /rig/description", string_cdr(text))])
    for data in heavy_clouds().values():
        yield _case([(f"publish {topic}", data) for topic in ("/daq/samples", "/friction/windows", "/truth/samples")])


def cases(_corpus):
    """Some messages and requests, one right after the other; now and then a node started with a spoilt file."""
    rig = (config_directory() / "rig.yaml").read_text(encoding="utf-8")
    # The simulator would find the rig there, and the others end by themselves only where the file is refused.
    starts = st.tuples(
        st.sampled_from((*CONSUMERS, "recorder")).map(lambda name: f"start {name}"),
        odd_texts(rig).map(lambda text: text.encode("utf-8", "surrogatepass")),
    )
    action = st.one_of(_publications(), _publications(), _requests(), _requests())
    many = st.lists(action, min_size=_ACTIONS, max_size=_ACTIONS)
    return st.one_of(many, many, many, many, st.tuples(starts).map(list)).map(_case)


# --- the graph it is sent to


class Tester:
    """All nodes and the console as processes, and a node that talks to them; all start anew when one has ended."""

    def __init__(self, _kind, corpus):
        self._corpus = corpus
        self._nodes = {}
        self._told = {}
        self._rounds = 0

    def start(self):
        """Start everything, and wait until every node has told its health."""
        from .talker import Talker

        self._domain = private_domain()
        domain = self._domain.__enter__()
        self._folder = tempfile.TemporaryDirectory(prefix="squeal_rig_fuzz_")
        self._processes = Processes(domain, Path(self._folder.name))
        self._talker = Talker(domain)
        sim = parameters(use_sim_time="true")
        start = self._start_node
        for name in CONSUMERS:
            self._nodes[name] = start(name, *sim)
        self._nodes["recorder"] = start(
            "recorder", *sim, *parameters(topics=["*"], directory=f"{self._folder.name}/bag")
        )
        self._nodes["player"] = self._player()
        self._nodes["rig"] = start("simulator", *parameters(sample_rate=6400, damping_x=20.0, damping_y=20.0))
        self._nodes["console"] = self._processes.start([sys.executable, "-m", "tests.fuzz.graph"])
        self._talker.wait_for(lambda: all(health_of(self._talker.health, name) for name in NODES), "health", 600.0)
        self._talker.publish("/rig/description", string_cdr(DESCRIPTION))

    def _start_node(self, name, *arguments):
        return self._processes.node(name, *arguments, cwd=self._folder.name)

    def _player(self):
        remap = [f"/{name}/:=/played/{name}/" for name in ("daq", "truth", "rig")]
        options = parameters(
            bag=self._corpus / "plain", start_paused="true", loop="true", remap=remap, use_sim_time="true"
        )
        return self._start_node("player", *options)

    def examine(self, case):
        """Send all of a case, then see that everybody answered, works and has something to say."""
        if not self._nodes:
            self.start()
        if [name for name in case.facts.values() if name.startswith("start ")]:
            return [text for place, name in case.facts.items() for text in self._try_start(name, case.files[place])]
        self._rounds += 1
        for place in sorted(case.files):
            self._talker.act(case.facts[place], case.files[place])
        found = [f"no answer of {name} within {DEADLINE:g} s" for name in self._talker.unanswered(DEADLINE)]
        found += self._look()
        if found or any(not node.running for node in self._nodes.values()):
            return found + self._stop()
        self._talker.cure(_GOOD)
        refused = [
            data for place, data in case.files.items() if case.facts[place] == "publish /daq/samples" and _refused(data)
        ]
        if refused and self._rounds % 4 == 0:
            found += self._deaf(refused)
        return found

    def _look(self):
        """What can be seen of the nodes now: whether they run, whether they are heard, what they print."""
        found = []
        if not self._nodes["player"].running and self._nodes["player"].wait() == 0:
            self._nodes["player"] = self._player()  # its bag was over
        self._talker.health.clear()
        end = time.monotonic() + DEADLINE
        waiting = [name for name in self._nodes if name != "console"]
        while waiting and time.monotonic() < end:
            self._talker.spin(0.1)
            waiting = [
                name for name in waiting if self._nodes[name].running and not health_of(self._talker.health, name)
            ]
        found += [f"{name} is silent for {DEADLINE:g} s" for name in waiting]
        for name, node in self._nodes.items():
            found += self._printed(name, node)
            if not node.running:
                found.append(f"the process {name} ended with {node.wait()}\n{node.errors[-3000:]}")
        return found

    def _printed(self, name, node):
        """Findings in what a node has printed since it was last asked."""
        text = node.errors[self._told.get(node, 0) :]
        self._told[node] = self._told.get(node, 0) + len(text)
        failures = {(kind, file, line) for kind, file, line in _FAILURE.findall(text) if file in _SOURCES}
        found = [f"a callback of {name} failed: {' '.join(failure)}\n{text[-3000:]}" for failure in sorted(failures)]
        return [*found, f"printed by {name}\n{text[-5000:]}"] if "Traceback" in text else found

    def _deaf(self, refused):
        """Of a rig of which every block is refused, nobody says that all is well."""
        self._talker.act("pause rig", b"true")
        self._talker.unanswered(DEADLINE)
        self._talker.spin(0.5)
        found, begin = [], time.monotonic()
        while (past := time.monotonic() - begin) < 3.5:
            if past < 2.0:
                self._talker.health.clear()
            self._talker.publish("/daq/samples", refused[int(past * 20) % len(refused)])
            self._talker.spin(0.05)
        for name in CONSUMERS:
            told = health_of(self._talker.health, name)
            if told and told[0] == 0:
                found.append(f"called sound: {name} says {told[1]!r} while all it gets is refused")
        self._talker.act("pause rig", b"false")
        self._talker.unanswered(DEADLINE)
        return found

    def _try_start(self, name, text):
        """A node on a spoilt file runs, or refuses it in a sentence with exit code 2."""
        executable = name.removeprefix("start ")
        path = Path(self._folder.name) / "spoilt.yaml"
        path.write_bytes(text)
        options = ["--params-file", str(path), "-r", f"__ns:=/started{len(self._told)}"]
        if executable == "recorder":
            options += parameters(autostart="false")
        node = self._start_node(executable, *options)
        end = time.monotonic() + 5.0
        while node.running and time.monotonic() < end:
            self._talker.spin(0.05)
        code = node.end(signal.SIGINT)[0] if node.running else node.wait()
        found = self._printed(executable, node)
        return (
            found
            if code in (0, 2)
            else [*found, f"the process {executable} ended with {code} on a spoilt file\n{node.errors[-3000:]}"]
        )

    def _stop(self):
        """End everything; whoever runs ends with code 0."""
        found = []
        running = {name: node for name, node in self._nodes.items() if node.running}
        for node in running.values():
            node.send(signal.SIGINT)
        for name, node in running.items():
            try:
                code = node.wait(DEADLINE)
            except Exception:
                found.append(f"{name} does not end within {DEADLINE:g} s of SIGINT")
                continue
            found += self._printed(name, node)
            if code != 0 and name != "console":
                found.append(f"{name} ended on SIGINT with {code}\n{node.errors[-3000:]}")
        self._processes.end_all()
        self._talker.close()
        self._domain.__exit__(None, None, None)
        self._folder.cleanup()
        self._nodes, self._told = {}, {}
        return found

    def close(self):
        """End everything; its findings."""
        return self._stop() if self._nodes else []


def _refused(data):
    try:
        block_from_cdr(data, DAQ_CHANNELS)
    except SquealRigError:
        return True
    return False


def _console():
    """The console of `squeal-rig run`, on a terminal that nobody sees."""
    from rich.console import Console

    from squeal_rig.session.console import StateDisplay
    from squeal_rig.session.live import LiveGraph

    die_with_parent()
    ended = []
    signal.signal(signal.SIGINT, lambda *_: ended.append(True))
    graph = LiveGraph(lambda: None)
    with (
        open(os.devnull, "w", encoding="utf-8") as nowhere,
        StateDisplay(Console(file=nowhere, force_terminal=True), graph.state) as display,
    ):
        while not ended:
            graph.spin()
            display.refresh()
    graph.close()


if __name__ == "__main__":
    _console()
