"""No node: the process beside the node `stability`. A line of JSON in, parameters by name; one out, their status."""

from __future__ import annotations

import json

from squeal_rig.errors import SquealRigError
from squeal_rig.estimation.hard_squeal import Status, hard_squeal, unavailable
from squeal_rig.graph.answering import answer_beside
from squeal_rig.model.parameters import RigParameters


def main() -> int:
    """Answer until standard input ends, and then end at once whatever is being computed."""
    return answer_beside(_answered)


def _answered(line: str) -> Status:
    try:
        return hard_squeal(RigParameters.from_mapping(json.loads(line)))
    except SquealRigError as error:
        return unavailable(str(error))
    except Exception as error:
        return unavailable(f"{type(error).__name__}: {error}")
