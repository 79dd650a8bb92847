"""SROS2 policies of all nodes, read off the live graph: what each may publish, subscribe to, answer and ask.

python -m tests.graph.policies config/security/policy.xml
"""

import sys
import tempfile
import time
from pathlib import Path
from xml.etree import ElementTree

from squeal_rig.configuration.files import config_directory
from squeal_rig.nodes.start import NODES

from .domains import private_domain
from .processes import Processes, parameters

#: Kinds of permission: their element in a policy file, and the element of one name in it.
KINDS = {
    "publish": ("topics", "topic"),
    "subscribe": ("topics", "topic"),
    "reply": ("services", "service"),
    "request": ("services", "service"),
}
_ASKED = {
    "publish": "get_publisher_names_and_types_by_node",
    "subscribe": "get_subscriber_names_and_types_by_node",
    "reply": "get_service_names_and_types_by_node",
    "request": "get_client_names_and_types_by_node",
}
#: What only some settings or moments show, beside what every run does.
_AT_TIMES = {
    # The clock of a simulation that does not run in real time; the listener that looks who else is called so, at start.
    "rig": {("publish", "/clock"), ("subscribe", "/diagnostics"), ("reply", "listener/get_type_description")},
    "player": {("publish", "/clock")},
}
#: Nodes that live in the process, and so in the enclave, of another one.
WITHIN = {"rig_stop": "rig"}
# Of every node, once, when it is first seen: by those who follow parameters.
_FOLLOWERS, _ASKED_ONCE = ("recorder", "page", "foxglove"), ("get_parameters", "list_parameters")
_CLOCKS = {"rig"}  # all others follow one
_REFERENCE = Path(__file__).parents[2] / "bags" / "reference"
_QUIET = 4.0  # s without anything new
_PATIENCE = 120.0
_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<!-- What each node may do, and no more: written by `make policy` from the running nodes. See docs/security.md. -->
"""


def read_policy(path):
    """The permissions of a policy file: node -> {(kind, topic or service)}, names relative to the rig's namespace."""
    found = {}
    for profile in ElementTree.parse(path).getroot().iter("profile"):
        grants = found.setdefault(profile.get("node"), set())
        for rule in profile:
            for kind in KINDS:
                if rule.get(kind) == "ALLOW":
                    grants |= {(kind, item.text) for item in rule}
    return found


def write_policy(nodes, path):
    """Write permissions as an SROS2 policy: one enclave a process."""
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")
    profiles = {}
    for name, grants in sorted(nodes.items()):
        process = WITHIN.get(name, name)
        if process not in profiles:
            enclave = ElementTree.SubElement(enclaves, "enclave", path=f"/squeal_rig/{process}")
            profiles[process] = ElementTree.SubElement(enclave, "profiles")
        profile = ElementTree.SubElement(profiles[process], "profile", ns="/", node=name)
        for kind, (plural, singular) in KINDS.items():
            allowed = sorted(what for given, what in grants if given == kind)
            if allowed:
                rule = ElementTree.SubElement(profile, plural, {kind: "ALLOW"})
                for what in allowed:
                    ElementTree.SubElement(rule, singular).text = what
    ElementTree.indent(root)
    Path(path).write_text(_HEAD + ElementTree.tostring(root, encoding="unicode") + "\n", encoding="utf-8")


def look(observer):
    """What every node of the graph is seen to do now, other than the observer."""
    found = {}
    for name, namespace in observer.node.get_node_names_and_namespaces():
        if name == "observer":
            continue
        grants = found.setdefault(name, set())
        for kind, query in _ASKED.items():
            try:
                names = getattr(observer.node, query)(name, namespace)
            except RuntimeError:  # gone since it was listed
                continue
            grants |= {(kind, _relative(full, namespace)) for full, _ in names}
    return found


def _relative(full, namespace):
    # Only these names are the same in every namespace.
    absolute = ("/clock", "/diagnostics", "/parameter_events", "/rosout")
    if full in absolute:
        return full
    prefix = f"{namespace.rstrip('/')}/"
    return full[len(prefix) :] if full.startswith(prefix) else full


def look_until_quiet(processes, observer, folder):
    """Start every node and the session's console; what they do until nothing new has come for a while."""
    config = config_directory() / "rig.yaml"
    console = processes.command("run", "--config", config, "--bag", folder / "bag", cwd=folder)
    seen = {}

    def take():
        changed = False
        for name, grants in look(observer).items():
            known = seen.setdefault(name, set())
            changed |= not grants <= known
            known |= grants
        return changed

    def settle(complete):
        begin = last = time.monotonic()
        while time.monotonic() - last < _QUIET or not complete():
            observer.spin(0.3)
            if take():
                last = time.monotonic()
            assert console.running, console.errors
            assert time.monotonic() - begin < _PATIENCE, f"the nodes {sorted(seen)} did not settle: {console.output}"

    settle(lambda: ("publish", "squeal/state") in seen.get("squeal_detector", ()) and "recorder" in seen)
    for name in sorted(set(NODES) - set(seen) - {"simulator"}):
        options = parameters(bag=_REFERENCE, loop=True, remap=["/:=/replay/"]) if name == "player" else []
        processes.node(name, "--params-file", config, *options, "-r", "__ns:=/replay", cwd=folder)
    settle(lambda: set(NODES) - {"simulator"} <= set(seen))
    seen.pop("listener", None)  # a node of the rig's process, and gone again
    for name, grants in seen.items():
        grants.difference_update([grant for grant in grants if grant[1].startswith("observer/")])
        grants.update(_AT_TIMES.get(name, ()))
        if name not in _CLOCKS:
            grants.add(("subscribe", "/clock"))
    asked = {("request", f"{name}/{service}") for name in seen for service in _ASKED_ONCE}
    for follower in _FOLLOWERS:  # whom each has met until now is a matter of chance
        met = {grant for grant in seen[follower] if grant[0] == "request" and grant[1].endswith(_ASKED_ONCE)}
        seen[follower] = seen[follower] - met | asked
    return {name: grants for name, grants in seen.items() if not name.startswith("_")}


def main(path):
    """Write the policy file anew."""
    from squeal_rig.instruments.warm_up import warm_up

    from .observer import Observer

    warm_up()  # else the nodes compile all at once, each for itself
    with private_domain() as domain, tempfile.TemporaryDirectory() as folder:
        processes = Processes(domain, Path(folder))
        observer = Observer(domain)
        try:
            write_policy(look_until_quiet(processes, observer, Path(folder)), path)
        finally:
            observer.close()
            processes.end_all()


if __name__ == "__main__":
    main(sys.argv[1])
