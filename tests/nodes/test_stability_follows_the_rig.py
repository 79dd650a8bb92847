"""The stability node follows the rig's parameters, and what is in force follows the set points with slew."""

import numpy as np
import pytest

from squeal_rig.model import eigenvalues, stability_band
from squeal_rig.model.core.law import friction_coefficient
from tests.graph.statuses import status_of

pytest.importorskip("rclpy")


def _set_point(bench):
    return status_of(bench.summaries[-1], "stability: set point") if bench.summaries else None


def _published_eigenvalues(message):
    assert [(dim.label, dim.size) for dim in message.layout.dim] == [("eigenvalue [rad/s]", 4), ("re, im", 2)]
    table = np.reshape(message.data, (4, 2))
    return np.sort_complex(table[:, 0] + 1j * table[:, 1])


def test_a_new_preload_changes_the_stability_summary(bench):
    # How fast is measured by `make bench ARGS=nodes`.
    for preload, state in ((300.0, "unstable"), (60.0, "stable")):
        assert bench.observer.set({"preload": preload}) == [(True, "")]
        bench.observer.wait_for(
            lambda preload=preload: float(_set_point(bench)[2]["preload [N]"]) == preload, "the new summary"
        )
        assert _set_point(bench)[1] == state


@pytest.mark.parametrize(
    "changes",
    [{"preload": 300.0}, {"belt_speed": 3.0}, {"k1": 6e7, "k2": 5e7}, {"mu0": 0.6}, {"friction_speed": "slip"}],
)
def test_eigenvalues_and_summary_are_those_of_the_changed_parameters(bench, changes):
    bench.rest()
    expected = bench.observer.description().parameters.replace(**changes)
    assert bench.observer.set(changes, atomically=True) == [(True, "")]
    try:
        # Bit for bit: the node calls the same function on the same numbers.
        wanted = np.sort_complex(eigenvalues(expected))
        bench.observer.wait_for(
            lambda: np.array_equal(_published_eigenvalues(bench.eigenvalues[-1]), wanted), "the new eigenvalues"
        )
        growth = float(np.max(wanted.real))
        bench.observer.wait_for(lambda: float(_set_point(bench)[2]["growth rate [1/s]"]) == growth, "the new summary")
        level, message, values = _set_point(bench)
        assert (level, message) == ((1, "unstable") if growth > 0.0 else (0, "stable"))
        assert float(values["mu"]) == friction_coefficient(expected)
        assert float(values["k_cr [N/m]"]) == pytest.approx(stability_band(expected)[0], rel=1e-12)
        assert values["mu source"] == "set"
    finally:
        assert bench.observer.set({"friction_speed": "belt"}) == [(True, "")]


def test_the_summary_tells_set_point_and_in_force_apart_while_the_preload_slews(bench):
    bench.rest()
    # It slews for 50 s: a busy machine gives few summaries, and only the newest one is looked at.
    assert bench.observer.set({"preload_slew_rate": 5.0, "preload": 300.0}, atomically=True) == [(True, "")]
    name = "stability: in force"

    def slewing():
        status, wanted = status_of(bench.summaries[-1], name), float(_set_point(bench)[2]["preload [N]"])
        return status and 50.0 < float(status[2]["preload [N]"]) < 300.0 == wanted

    bench.observer.wait_for(slewing, "a summary of the set point while the preload moves")


def test_the_summary_carries_the_estimated_friction_beside_the_set_one(bench):
    bench.rest(preload=80.0)
    name = "stability: in force, estimated mu"
    law = friction_coefficient(bench.observer.description().parameters)

    def settled():
        status = status_of(bench.summaries[-1], name)
        # The ratio of means of a steady window meets the law to 0.1 %, which another test shows.
        return status and abs(float(status[2]["mu"]) / law - 1.0) < 1e-3

    bench.observer.wait_for(settled, "the estimate of a window at 80 N")
    assert status_of(bench.summaries[-1], name)[2]["mu source"] == "estimated"
    assert float(_set_point(bench)[2]["mu"]) == law


def test_the_preload_channel_moves_at_its_slew_rate_and_arrives(bench):
    bench.rest()
    rate = 500.0
    assert bench.observer.set({"preload_slew_rate": rate}) == [(True, "")]
    begin = bench.next_block().samples["seq"][-1]
    assert bench.observer.set({"preload": 200.0}) == [(True, "")]
    bench.observer.wait_for(lambda: bench.in_force()[0] == 200.0, "200 N in force")
    values = [block.samples["preload"] for block in bench.daq if block.samples["seq"][0] > begin]
    # Constant over a block of 10 ms, since changes are taken at block boundaries.
    assert all(np.all(block == block[0]) for block in values)
    steps = np.diff([block[0] for block in values])
    moving = steps[steps != 0.0]
    assert len(moving) in (29, 30)  # 150 N at 5 N a block; the first step may lie before the first block seen here
    np.testing.assert_allclose(moving, rate * 0.01, rtol=1e-9)  # rounding of sums near 200


def test_belt_speed_and_stiffness_follow_with_slew_too(bench):
    bench.rest()
    assert bench.observer.set({"belt_acceleration": 5.0}) == [(True, "")]
    begin = bench.next_block().samples["seq"][-1]
    assert bench.observer.set({"belt_speed": 2.0}) == [(True, "")]
    bench.observer.wait_for(lambda: bench.in_force()[1] == 2.0, "2 m/s in force")
    speeds = [block.samples["belt_speed"][0] for block in bench.daq if block.samples["seq"][0] > begin]
    steps = np.diff(speeds)
    np.testing.assert_allclose(steps[steps != 0.0], 0.05, rtol=1e-9)
    assert np.count_nonzero(steps) in (19, 20)


def test_the_rig_turns_unstable_at_run_time_when_the_arms_are_stiffened(bench):
    bench.rest(preload=100.0, k1=3.0e7, k2=3.0e7, impact_impulse=1e-4)
    p = bench.observer.description().parameters
    assert 3.0e7 < stability_band(p)[0] < 6.0e7 < stability_band(p)[1]

    def amplitude():
        return float(np.ptp(bench.next_block().samples["x"]))

    assert bench.observer.trigger("impact")[0]
    # Rounding is below 1e-14 m; blocks that were on their way are of before the impact.
    struck = bench.observer.wait_for(lambda: (seen := amplitude()) > 1e-11 and seen, "the impact")
    bench.observer.wait_for(lambda: amplitude() < 0.9 * struck, "a motion that dies away")
    assert bench.observer.set({"k1": 6e7, "k2": 6e7}, atomically=True) == [(True, "")]
    bench.observer.wait_for(lambda: amplitude() > 10.0 * struck, "a motion that grows")
