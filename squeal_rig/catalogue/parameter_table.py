"""The table of all parameters in the docs, written from their declarations."""

from __future__ import annotations

import math
import sys

from squeal_rig.catalogue.checking import NODE_PARAMETERS
from squeal_rig.configuration.declared import Declaration, Declared, declarations
from squeal_rig.configuration.files import yaml_scalar
from squeal_rig.drivers.bag import BagDriverSettings
from squeal_rig.drivers.hardware_settings import AcquisitionSettings, ChannelSource, ModbusUnit
from squeal_rig.drivers.registers import Register
from squeal_rig.experiments.springs import Spring

_HEAD = """# Parameters

Written by `make docs` from the declarations in the code; do not edit. Bounds are inclusive. *Assumed* values are not
published anywhere. *At run time* says whether a running node takes a change; constants of the machine and the contact
can be changed while the rig is inactive.
"""


#: Files that are no node's: title -> the dataclass that what is in them is declared in.
FILE_PARAMETERS: dict[str, type[Declared]] = {
    "driver `bag`": BagDriverSettings,
    "driver `opendaq`": AcquisitionSettings,
    "driver `opendaq`, each of `channels` (or `fixed`: a value that nobody measures)": ChannelSource,
    "driver `opendaq`, each of `modbus` (beside `registers`, `safe`, `start`)": ModbusUnit,
    "driver `opendaq`, each of a unit's `registers`": Register,
    "springs, each entry of a catalogue": Spring,
}
_FILES = """
## Files of drivers, and springs

Read at start; the driver `virtual` has no settings of its own. See [drivers](drivers.md) and
[hardware](hardware.md). All kinds of files: [files](files.md).
"""


def parameter_table() -> str:
    """Markdown: one table a node, one row a parameter."""
    parts = [_HEAD]
    for node, kinds in NODE_PARAMETERS.items():
        known = [declaration for kind in kinds for declaration in declarations(kind).values()]
        parts.append(f"\n## {node}\n\n")
        if not known:
            parts.append("It has none of its own: it follows the rig.\n")
            continue
        parts.append("| name | default | unit | bounds | at run time | what |\n|---|---|---|---|---|---|\n")
        parts += [_row(declaration) for declaration in known]
    parts.append(_FILES)
    for title, kind in FILE_PARAMETERS.items():
        parts.append(f"\n### {title}\n\n| name | default | unit | bounds | what |\n|---|---|---|---|---|\n")
        parts += [_row(declaration, run_time=False) for declaration in declarations(kind).values()]
    return "".join(parts)


def _row(d: Declaration, run_time: bool = True) -> str:
    default = ", ".join(d.default) if isinstance(d.default, tuple) else yaml_scalar(d.default)
    if d.options:
        bounds = ", ".join(d.options)
    elif math.isfinite(d.lower) and math.isfinite(d.upper):
        bounds = f"{d.lower:g} to {d.upper:g}"
    else:
        bounds = ""
    if d.multiple:
        bounds += f", multiples of {d.multiple}"
    at_run_time = "no" if d.read_only else "inactive only" if d.concern in ("machine", "contact") else "yes"
    column = f" {at_run_time} |" if run_time else ""
    what = d.description + (" (assumed)" if d.assumed else "")
    return f"| `{d.name}` | {default} | {d.unit} | {bounds} |{column} {what} |\n"


if __name__ == "__main__":
    sys.stdout.write(parameter_table())
