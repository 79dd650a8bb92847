"""Runs a plan against a rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from squeal_rig.experiments.plan import Plan

RUN_STARTED, RUN_ENDED = "run started", "run ended"
STEP_BEGUN, STEP_ENDED = "step begun", "step ended"
#: Parameter of the node `console` by which a mechanic says that the springs of that name are fitted.
FITTED = "spring_fitted"


class Rig(Protocol):
    """What a plan needs of a rig; every method may raise `ExperimentError`."""

    def set_parameters(self, values: Mapping[str, float | str]) -> None:
        """Set parameters; a refusal is an error."""

    def call(self, service: str) -> str:
        """Call `reset`, `impact` or `zero`; returns the rig's answer."""

    def smallest_hit(self) -> tuple[float, float]:
        """Smallest hit [N s] that starts squeal at the set point, and its direction [rad]."""

    def change_springs(self, name: str, stiffness: float, dwell: float) -> str:
        """Fit other springs [N/m], which a mechanic confirms within so long [s]; returns how that went."""

    def sampled_time(self) -> float:
        """Time sampled so far [s]."""

    def wait_until(self, sampled_time: float) -> None:
        """Return once that much has been sampled [s]."""


@dataclass(frozen=True)
class RunEvent:
    """What happened in a run, in words, with facts by name; `failed` where it should not have happened."""

    what: str
    facts: Mapping[str, object]
    failed: bool = False


def run_plan(plan: Plan, rig: Rig, tell: Callable[[RunEvent], None]) -> None:
    """Run every step in order; waits are counted from the step before, so they do not drift.

    Args:
        plan: what to do.
        rig: what to do it to.
        tell: called as a step begins and as it ends, however it ends; times are sampled time [s].

    Raises:
        ExperimentError: the rig refused, or did not get there in time.
    """
    begin = rig.sampled_time()
    for number, step in enumerate(plan.steps, 1):
        values = ", ".join(f"{name} = {value}" for name, value in step.set.items())
        facts: dict[str, object] = {"step": number, "of": len(plan.steps), "title": step.title, "begin [s]": begin}
        facts |= {"set": values, "call": step.call, "wait [s]": step.wait}
        if step.hit:
            facts["share of the smallest hit"] = step.hit
        tell(RunEvent(STEP_BEGUN, facts))
        try:
            if step.set:
                rig.set_parameters(step.set)
            if step.hit:
                smallest, direction = rig.smallest_hit()
                facts |= {"smallest hit [N s]": smallest, "direction [rad]": direction}
                rig.set_parameters({"impact_impulse": step.hit * smallest, "impact_direction": direction})
                begin = max(begin, rig.sampled_time())
            call = "impact" if step.hit else step.call
            answer = rig.call(call) if call else ""
            if step.spring:
                spring = plan.springs[step.spring]
                facts |= {"spring": step.spring, "stiffness [N/m]": spring.stiffness, "tolerance": spring.tolerance}
                answer = rig.change_springs(step.spring, spring.stiffness, step.dwell)
                begin = max(begin, rig.sampled_time())
            rig.wait_until(begin + step.wait)
        except BaseException as error:
            tell(RunEvent(STEP_ENDED, {**facts, "end [s]": rig.sampled_time(), "outcome": str(error)}, failed=True))
            raise
        begin += step.wait
        tell(RunEvent(STEP_ENDED, {**facts, "end [s]": begin, "outcome": "done", "answer": answer}))
