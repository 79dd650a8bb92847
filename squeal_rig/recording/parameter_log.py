"""All parameters of all nodes, at the start of a recording and at every change, as records for a bag."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from squeal_rig.configuration.files import dump_yaml, parse_yaml
from squeal_rig.errors import ConfigurationError, RecordingError

#: Names of the records: all parameters of a node when it was asked, and one change of them.
AT_START, CHANGE = "parameters", "parameter_change"
_MAX_NODES = 1000  # nodes come and go in a long recording; what is repeated in every file stays bounded
_MAX_VALUES = 1 << 18  # characters of YAML: some seconds' work
# What is kept of one node: characters of its names and values as they are about to be written, and characters of one
# number of an array. It is written in the thread that takes the samples, within a second.
_KEPT, _A_NUMBER = 1 << 16, 25
_REST = "left out"  # name of what tells how many others there were

Record = tuple[str, dict[str, str]]


class ParameterLog:
    """Follows the parameters of many nodes and words the records about them.

    `current` are the records with everything known by now, for the head of a bag's next file.
    """

    def __init__(self) -> None:
        self._nodes: dict[str, dict[str, Any]] = {}

    def __contains__(self, node: object) -> bool:
        return node in self._nodes

    def at_start(self, node: str, values: Mapping[str, Any], time_ns: int) -> Record:
        """Take all parameters of a node, asked for at that time [ns]; returns the record."""
        if node in self._nodes or len(self._nodes) < _MAX_NODES:
            self._nodes[node] = _bounded(values)
        return _record(AT_START, node, values, time_ns)

    def changed(self, node: str, values: Mapping[str, Any], deleted: tuple[str, ...], time_ns: int) -> Record:
        """Take a change; returns the record. Deleted parameters are null in it."""
        known = self._nodes.get(node)
        if known is not None:
            known |= values
            for name in deleted:
                known.pop(name, None)
            self._nodes[node] = _bounded(known)
        return _record(CHANGE, node, {**values, **dict.fromkeys(deleted)}, time_ns)

    def current(self, time_ns: int) -> list[Record]:
        """Records of all parameters as they are at that time [ns]."""
        return [_record(AT_START, node, values, time_ns) for node, values in self._nodes.items()]


def parameters_of(record: Mapping[str, str]) -> tuple[str, int, dict[str, Any]]:
    """Return (node, time [ns], name -> value) of a record that a ParameterLog has worded.

    Raises RecordingError when it is none.
    """
    try:
        values = parse_yaml(record["values"], "parameters of a node", _MAX_VALUES)
        return record["node"], int(record["time_ns"]), values if isinstance(values, dict) else {}
    except (KeyError, ValueError, ConfigurationError) as error:
        raise RecordingError(f"The bag has a damaged record of parameters ({error}).") from None


def _record(name: str, node: str, values: Mapping[str, Any], time_ns: int) -> Record:
    return name, {"node": node, "time_ns": str(time_ns), "values": dump_yaml(_bounded(values))}


def _bounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values as they are kept: a sentence in place of one that is too long, and of all that are beyond the bound."""
    kept: dict[str, Any] = {}
    left = _KEPT
    before = _number(values.get(_REST, ""))  # left out already
    values = {name: value for name, value in values.items() if name != _REST or not before}
    for name, value in values.items():
        items = len(value) if isinstance(value, (str, list)) else 1
        size = items * (1 if isinstance(value, str) else _A_NUMBER)
        if isinstance(value, list) and items * _A_NUMBER <= left:  # of texts, each may be long
            size = sum(len(item) if isinstance(item, str) else _A_NUMBER for item in value)
        fits = size <= left
        left -= len(name) + (size if fits else 40)
        if left < 0:
            before += len(values) - len(kept)
            break
        kept[name] = value if fits else f"left out: {items} {'characters' if isinstance(value, str) else 'values'}"
    return kept | ({_REST: f"{before} parameters"} if before else {})


def _number(text: Any) -> int:
    """How many parameters were left out, as an earlier call has told it."""
    count, _, unit = text.partition(" ") if isinstance(text, str) else ("", "", "")
    return int(count) if unit == "parameters" and count.isdecimal() and len(count) < 10 else 0
