"""Runs a plan against a rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from squeal_rig.experiments.plan import Plan, Step


class Rig(Protocol):
    """What a plan needs of a rig; every method may raise `ExperimentError`."""

    def set_parameters(self, values: Mapping[str, float | str]) -> None:
        """Set parameters; a refusal is an error."""

    def call(self, service: str) -> str:
        """Call `reset`, `impact` or `zero`; returns the rig's answer."""

    def sampled_time(self) -> float:
        """Time sampled so far [s]."""

    def wait_until(self, sampled_time: float) -> None:
        """Return once that much has been sampled [s]."""


@dataclass(frozen=True)
class StepRecord:
    """A step as it was run: when it began and ended [s of sampled time] and what the rig answered."""

    step: Step
    begin: float
    end: float
    answer: str


def run_plan(plan: Plan, rig: Rig, begun: Callable[[int, Step], None] | None = None) -> list[StepRecord]:
    """Run every step in order; waits are counted from the step before, so they do not drift.

    Args:
        plan: what to do.
        rig: what to do it to.
        begun: called with the number (from 0) and the step as it begins.

    Raises:
        ExperimentError: the rig refused, or did not get there in time.
    """
    records: list[StepRecord] = []
    begin = rig.sampled_time()
    for number, step in enumerate(plan.steps):
        if begun is not None:
            begun(number, step)
        answer = ""
        if step.set:
            rig.set_parameters(step.set)
        if step.call:
            answer = rig.call(step.call)
        end = begin + step.wait
        rig.wait_until(end)
        records.append(StepRecord(step, begin, end, answer))
        begin = end
    return records
