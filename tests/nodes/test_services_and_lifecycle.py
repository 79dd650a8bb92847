"""The rig's services and its lifecycle: what they do to the samples, and what they refuse."""

import numpy as np
import pytest

from squeal_rig.instruments.channels import FORCE_CHANNELS
from squeal_rig.model import equilibrium
from tests.graph.processes import parameters
from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

_NOT_ACTIVE = "the rig is not active: activate it first"


def _last_made(blocks, health, rig, state):
    """The last block that a rig made before it stopped, once that has come and the rig has told its state."""
    found = health_of(health, rig)
    stopped = found and found[1] == state and int(found[2]["samples"]) == blocks[-1].samples["seq"][-1] + 1
    return blocks[-1] if stopped else None


def test_an_impact_changes_the_momentum_by_its_impulse_at_a_block_boundary(bench):
    size, angle = 0.02, -2.0
    assert bench.observer.set({"impact_impulse": size, "impact_direction": angle}, atomically=True) == [(True, "")]
    # Taken while paused, it is in the next block to come.
    assert bench.observer.pause(True)[0]
    last = bench.observer.wait_for(lambda: _last_made(bench.daq, bench.health, "rig", "paused"), "the last block")
    answer = bench.observer.trigger("impact")
    assert answer == (True, f"impact of ({size * np.cos(angle):.4g}, {size * np.sin(angle):.4g}) N s")
    mass = bench.observer.description().parameters.mass
    assert bench.observer.pause(False)[0]
    following = int(last.samples["seq"][-1]) + 1

    def struck():
        return [block.samples for block in bench.truth if block.samples["seq"][0] == following]

    first = bench.observer.wait_for(struck, "the block after the impact")[0][0]
    # The first sample lies one sampling interval after the impact; at rest before, so the whole momentum is its.
    # By then arms and belt have changed it by the order of omega^2 / rate^2 / 2, 1 % at 7000 rad/s.
    momentum = mass * np.array([first["vx"], first["vy"]])
    np.testing.assert_allclose(momentum, [size * np.cos(angle), size * np.sin(angle)], atol=0.05 * size)
    assert bench.observer.set({"impact_direction": -np.pi / 2}) == [(True, "")]


def test_reset_brings_the_pad_to_rest_at_the_equilibrium_of_what_is_in_force(bench):
    # At 30 N sliding is stable: where it is not, rounding grows to a motion within some blocks.
    assert bench.observer.set({"preload": 30.0}) == [(True, "")]
    bench.observer.wait_for(lambda: bench.in_force()[0] == 30.0, "30 N in force")
    assert bench.observer.trigger("impact")[0]
    bench.observer.wait_for(lambda: np.ptp(bench.truth[-1].samples["x"]) > 1e-6, "a moving pad")
    assert bench.observer.trigger("reset")[0]
    rest = equilibrium(bench.observer.description().parameters)
    resting = bench.next_block(bench.truth).samples
    # Newton's iteration ends at rounding of the forces, some 1e-16 m here; the motion was 1e-6 m and more.
    np.testing.assert_allclose(resting["x"], rest[0], atol=1e-12)
    np.testing.assert_allclose(resting["y"], rest[1], atol=1e-12)


def test_while_paused_no_block_comes_and_then_seq_goes_on_with_a_new_t0(bench):
    assert bench.observer.pause(True) == (True, "paused")
    assert bench.observer.pause(True) == (True, "paused already")
    # What was under way arrives; after that half a second without a block, in which fifty would have come.
    last = bench.observer.wait_for(lambda: _last_made(bench.daq, bench.health, "rig", "paused"), "the last block")
    bench.observer.spin(0.5)
    assert bench.daq[-1] is last
    # Changes and impacts are taken while paused, and in force afterwards.
    assert bench.observer.set({"preload": 55.0}) == [(True, "")]
    resumed = bench.observer.node.get_clock().now().nanoseconds
    assert bench.observer.pause(False) == (True, "running")
    bench.observer.wait_for(lambda: bench.daq[-1] is not last, "a block after the pause")
    blocks = [block for block in bench.daq if block.samples["seq"][0] > last.samples["seq"][-1]]
    following = blocks[0]
    assert following.samples["seq"][0] == last.samples["seq"][-1] + 1
    assert following.stamp_ns >= resumed > last.stamp_ns + 500_000_000
    assert following.samples["preload"][0] == 55.0


def test_zero_tares_the_force_channels_and_the_description_carries_the_offsets(bench):
    before = bench.next_block().samples
    answer, message = bench.observer.trigger("zero")
    assert answer
    assert "tared on the unloaded rig" in message
    tared = bench.next_block().samples
    offsets = bench.observer.description().tare
    assert set(offsets) == set(FORCE_CHANNELS)
    for channel in FORCE_CHANNELS:
        offset = float(before[channel].mean())
        assert offsets[channel] == pytest.approx(offset, rel=1e-6, abs=1e-6)
        # At rest: what is left is rounding of the offset.
        np.testing.assert_allclose(tared[channel], 0.0, atol=1e-6 * max(1.0, abs(offset)))
    assert abs(before["arm_left"].mean()) > 1.0
    assert bench.observer.trigger("reset")[0]
    assert bench.observer.description().tare == {}
    np.testing.assert_allclose(bench.next_block().samples["arm_left"], before["arm_left"].mean(), rtol=1e-6)


def test_the_lifecycle_decides_what_may_be_set_and_called(compiled, processes, observer):
    ns = "/lab"
    rig = f"{ns}/rig"
    node = processes.node("simulator", "-r", f"__ns:={ns}", *parameters(autostart="false"))
    blocks = observer.follow_samples(f"{ns}/daq/samples")
    assert observer.state(rig) == "unconfigured"
    for service in ("reset", "impact", "zero"):
        assert observer.trigger(service, rig) == (False, _NOT_ACTIVE)
    assert observer.pause(True, rig) == (False, _NOT_ACTIVE)
    # Constants of the machine can be set while it does not run, within their bounds.
    assert observer.set({"mass": 5.0}, rig) == [(True, "")]
    ((successful, reason),) = observer.set({"mass": -5.0}, rig)
    assert not successful
    assert "range" in reason
    assert observer.transition("configure", rig)
    assert observer.state(rig) == "inactive"
    assert observer.description(rig).parameters.mass == 5.0
    # At 40 N sliding is stable: where it is not, the pad moves by itself before long.
    assert observer.set({"mass": 20.0, "preload": 40.0}, rig, atomically=True) == [(True, "")]
    assert observer.description(rig).parameters.mass == 20.0
    assert observer.trigger("impact", rig) == (False, _NOT_ACTIVE)
    assert not blocks

    observer.wait_for_listeners("daq/samples", 1, rig)
    assert observer.transition("activate", rig)
    observer.wait_for(lambda: len(blocks) >= 3, "blocks of the active rig")
    assert observer.state(rig) == "active"
    assert blocks[0].samples["seq"][0] == 0
    assert blocks[0].samples["preload"][0] == 40.0
    ((successful, reason),) = observer.set({"mass": 5.0}, rig)
    assert not successful
    assert reason == (
        "mass is a constant of the machine: it cannot change while the rig is active, deactivate it first"
    )
    # The pad has the mass it was given: an impact moves it with size / mass.
    truth = observer.follow_samples(f"{ns}/truth/samples")
    assert observer.set({"impact_impulse": 0.01, "impact_direction": 0.0}, rig, atomically=True) == [(True, "")]
    observer.wait_for(lambda: truth, "truth")
    assert observer.trigger("impact", rig)[0]
    observer.wait_for(lambda: np.max(truth[-1].samples["vx"]) > 1e-5, "a moving pad")
    first = next(block.samples["vx"][0] for block in truth if np.max(block.samples["vx"]) > 1e-5)
    # One sample after the impact: cos(7000 / 51200) is 1 % less, and what moved before is rounding.
    assert first == pytest.approx(0.01 / 20.0, rel=0.03)

    assert observer.transition("deactivate", rig)
    assert observer.state(rig) == "inactive"
    health = observer.follow("/diagnostics")
    last = observer.wait_for(lambda: _last_made(blocks, health, "lab/rig", "inactive"), "the last block")
    last = last.samples["seq"][-1]
    assert observer.set({"mass": 7.0}, rig) == [(True, "")]
    # Sample numbers count over the whole run, also through a clean-up.
    assert observer.transition("cleanup", rig)
    assert observer.state(rig) == "unconfigured"
    assert observer.transition("configure", rig)
    assert observer.transition("activate", rig)
    observer.wait_for(lambda: blocks[-1].samples["seq"][-1] > last, "a block of the second run")
    following = next(block for block in blocks if block.samples["seq"][0] > last)
    assert following.samples["seq"][0] == last + 1
    assert observer.description(rig).parameters.mass == 7.0
    code, _ = node.end()
    assert code == 0
    assert "Traceback" not in node.errors


@pytest.mark.slow
def test_after_shutdown_nothing_advises_an_activation_that_cannot_be(compiled, processes, observer):
    node = processes.node("simulator")
    assert observer.state() == "active"
    assert observer.transition("shutdown")
    assert observer.state() == "finalized"
    assert observer.trigger("reset") == (False, "the rig was shut down: start its node again")
    health = observer.follow("/diagnostics")
    observer.wait_for(lambda: (state := health_of(health, "rig")) and state[1] == "shut down", "health after shutdown")
    assert node.end()[0] == 0


@pytest.mark.slow
def test_an_activation_that_cannot_be_is_a_failed_transition_and_leaves_the_node_alive(compiled, processes, observer):
    rig = "/impossible/rig"
    stiffness = parameters(k1=0.0, k2=0.0, k3=0.0, k4=0.0)
    node = processes.node("rig", "-r", "__ns:=/impossible", *parameters(autostart="false"), *stiffness)
    assert not observer.transition("configure", rig)
    assert observer.state(rig) == "unconfigured"
    assert observer.set({"k3": 1e8, "k4": 1e8, "k1": 4e7}, rig, atomically=True) == [(True, "")]
    assert observer.transition("configure", rig)
    assert observer.transition("activate", rig)
    assert observer.state(rig) == "active"
    assert node.end()[0] == 0
