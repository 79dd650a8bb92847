"""The table of all parameters in the docs, written from their declarations."""

from __future__ import annotations

import math
import sys

from squeal_rig.catalogue.checking import NODE_PARAMETERS
from squeal_rig.configuration.declared import Declaration, declarations
from squeal_rig.configuration.files import yaml_scalar

_HEAD = """# Parameters

Written by `make docs` from the declarations in the code; do not edit. Bounds are inclusive. *Assumed* values are not
published anywhere. *At run time* says whether a running node takes a change; constants of the machine and the contact
can be changed while the rig is inactive.
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
    return "".join(parts)


def _row(d: Declaration) -> str:
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
    what = d.description + (" (assumed)" if d.assumed else "")
    return f"| `{d.name}` | {default} | {d.unit} | {bounds} | {at_run_time} | {what} |\n"


if __name__ == "__main__":
    sys.stdout.write(parameter_table())
