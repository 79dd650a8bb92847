"""Node `rig` with the driver fixed to `virtual`: the simulator."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from squeal_rig.graph.lifetime import run_node
from squeal_rig.nodes.rig import RigNode


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(lambda lifetime: RigNode(lifetime, fixed_driver="virtual"), args)


if __name__ == "__main__":
    sys.exit(main())
