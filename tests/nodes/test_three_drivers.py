"""The same nodes, parameters and bag layout on the virtual rig, a bag and hardware: only the driver's YAML differs."""

import time

import pytest

from squeal_rig.configuration.files import parse_yaml
from squeal_rig.drivers.hardware_settings import load_hardware
from squeal_rig.drivers.modbus import Line
from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.samples.blocks import text_reader
from tests.drivers.conftest import needs_extra, serve_twin
from tests.graph.processes import PATIENT, PATIENT_RIG, parameters
from tests.graph.statuses import health_of, status_of

pytest.importorskip("rclpy")
pytestmark = pytest.mark.slow  # three graphs of six processes, twice

# Zones are computed beside, for longer than these runs take.
NODES = {"friction_estimator": (), "stability": parameters(hard_squeal=False), "squeal_detector": ()}
DRIVERS = ("virtual", "bag", "opendaq")
ERROR = 2
# What nobody but the model knows; its recording has it too, hardware does not.
TRUTH = {"/truth/samples"}


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    needs_extra()
    served = serve_twin(tmp_path_factory.mktemp("twin"))
    yield served
    served.kill()


@pytest.fixture(scope="module")
def bags(compiled, twin, processes, observer, config_file, tmp_path_factory):
    """Driver -> bag of some seconds, each with every node on the file that ships."""
    folder = tmp_path_factory.mktemp("bags")
    files = ["--params-file", str(config_file)]
    configs = {"virtual": folder / "virtual.yaml", "bag": folder / "bag.yaml", "opendaq": twin.config}
    configs["virtual"].write_text("driver: virtual\n")
    configs["bag"].write_text(f"driver: bag\nbag: {folder / 'virtual'}\n")
    for driver in DRIVERS:
        recorder = processes.node("recorder", *files, *parameters(directory=folder / driver))
        consumers = [processes.node(name, *files, *more) for name, more in NODES.items()]
        with observer.following_for_a_while():
            health, windows = observer.follow("/diagnostics"), observer.follow_samples("friction/windows")
            observer.wait_for(lambda health=health: health_of(health, "recorder"), "the recorder")
            rig = processes.node(
                "rig", *files, *parameters(driver=driver, driver_config=configs[driver], autostart=False)
            )

            def heard(health=health):
                """Whether recorder and consumers have found the rig: a bag is soon over."""
                state = health_of(health, "rig")
                return state is not None and int(state[2]["listeners to daq/samples"]) >= len(NODES) + 1

            observer.wait_for(heard, "everybody to listen")
            assert observer.transition("configure")
            assert observer.transition("activate")
            # The bag that is given again is longer than what is waited for.
            wanted = 30 if driver == "virtual" else 8
            observer.wait_for(lambda windows=windows, n=wanted: len(windows) >= n, f"windows on {driver}", 300.0)
            observer.wait_for(lambda health=health, rig=rig: health_of(health, "rig"), "the rig's health")
            level, sentence, values = health_of(health, "rig")
            assert values["driver"] == driver
            assert level != ERROR, sentence
        for node in (rig, *consumers, recorder):
            code, _ = node.end()
            assert code == 0, node.errors
    return {driver: Bag(folder / driver) for driver in DRIVERS}


def described(bag):
    """Keys of the last description in a bag, with the kinds of their values."""
    topic = "/rig/description"
    read = text_reader(bag, topic)
    content = parse_yaml([read(message.data) for message in bag.messages([topic])][-1], topic)
    return {key: type(value) for key, value in content.items()}, content


def test_the_rigs_description_has_the_same_keys_and_differs_in_nothing_but_the_driver(bags):
    kinds, first = described(bags["virtual"])
    for driver in DRIVERS[1:]:
        other_kinds, other = described(bags[driver])
        assert other_kinds == kinds
        differing = {key for key in first if first[key] != other[key]}
        assert differing <= {"driver", "publishes_truth"}, driver
        assert other["driver"] == driver


def test_bags_have_the_same_topics_in_the_same_types_with_the_same_quality_of_service(bags):
    def layout(bag):
        # Topics of all nodes are found with as many publishers as there are at that moment.
        return {name: (topic.type_name, set(topic.qos)) for name, topic in bag.topics.items() if name not in TRUTH}

    for driver in DRIVERS[1:]:
        assert layout(bags[driver]) == layout(bags["virtual"]), driver
    assert set(bags["bag"].topics) >= TRUTH
    assert not set(bags["opendaq"].topics) & TRUTH


@pytest.mark.parametrize("topic", ["/daq/samples", "/friction/samples", "/friction/windows"])
def test_samples_have_the_same_channels_in_the_same_record(bags, topic):
    def record(bag):
        return samples_from_cdr(next(bag.messages([topic])).data).samples.dtype

    for driver in DRIVERS[1:]:
        assert record(bags[driver]) == record(bags["virtual"]), driver


def test_every_node_tells_its_health_on_every_driver(bags):
    for driver, bag in bags.items():
        assert bag.topics["/diagnostics"].message_count > 0, driver
        assert bag.topics["/friction/mu"].message_count >= 8, driver
        assert bag.topics["/stability/summary"].message_count > 0, driver


def test_on_hardware_what_it_cannot_do_is_refused_and_a_pulled_cable_is_mended_by_a_reset(
    bags, twin, processes, observer, config_file
):
    rig = processes.node(
        "rig", "--params-file", str(config_file), *parameters(driver="opendaq", driver_config=twin.config)
    )
    blocks, health = observer.follow_samples("daq/samples"), observer.follow("/diagnostics")
    observer.wait_for(lambda: blocks, "samples")
    assert observer.set({"preload": 80.0}) == [(True, "")]
    ((accepted, reason),) = observer.set({"k1": 5.0e7})
    assert (accepted, "cannot be moved by this rig's driver" in reason) == (False, True)
    done, message = observer.pause(True)
    assert (done, "would run on unwatched" in message) == (False, True)
    done, message = observer.trigger("impact")
    assert (done, "cannot give the pad an impact" in message) == (False, True)
    observer.wait_for(lambda: abs(blocks[-1].samples["preload"][-1] - 80.0) < 0.01, "80 N as measured")
    twin.kill()

    def fault():
        state = health_of(health, "rig")
        return state and state[0] == ERROR and "call ~/reset to start again" in state[1] and state[1]

    sentence = observer.wait_for(fault, "the fault")
    assert "stale: no samples" in sentence or "without success for" in sentence
    assert not observer.trigger("reset")[0]
    twin.start()
    assert observer.trigger("reset") == (True, "the driver has begun anew; tare forgotten")
    blocks.clear()
    observer.wait_for(lambda: blocks, "samples after the reset")
    observer.wait_for(lambda: abs(blocks[-1].samples["preload"][-1] - 80.0) < 0.01, "80 N again")
    assert observer.transition("deactivate")
    unit = load_hardware(str(twin.config)).units["preload_unit"]
    assert Line("preload_unit", unit, 5.0).read("enable") == 0.0  # an inactive rig stands
    assert rig.end()[0] == 0
    assert "Traceback" not in rig.errors


def test_a_pulled_cable_trips_the_supervisor_and_is_mended_by_the_documented_procedure(
    compiled, twin, processes, observer, config_file, measured
):
    point = {"preload": 80.0, "belt_speed": 1.0}
    supervisor = processes.node("supervisor", *parameters(nodes=["rig"], **PATIENT))
    rig = processes.node(
        "rig",
        *("--params-file", str(config_file)),
        *parameters(driver="opendaq", driver_config=twin.config, supervisor_required=True, **PATIENT_RIG),
    )
    blocks, states, safe = (
        observer.follow_samples("daq/samples"),
        observer.follow("supervisor/state"),
        observer.follow("rig/safe"),
    )

    def level():
        return status_of(states[-1], "supervisor")[2]["level"] if states else ""

    observer.wait_for(lambda: blocks, "samples")
    assert observer.set(point, atomically=True) == [(True, "")]
    observer.wait_for(lambda: abs(blocks[-1].samples["preload"][-1] - 80.0) < 0.01, "80 N as measured")
    observer.wait_for(lambda: level() in ("ok", "warn"), "a level that lets it run")
    pulled = time.monotonic()
    twin.kill()
    observer.wait_for(lambda: level() == "emergency stop", "the trip")
    measured(f"cable pulled: the supervisor trips after {time.monotonic() - pulled:.2f} s")
    assert not observer.trigger("reset", rig="supervisor")[0], "the device is gone"
    twin.start()
    # docs/supervisor.md, After a trip.
    assert observer.transition("deactivate")
    assert observer.transition("activate")
    blocks.clear()
    observer.wait_for(lambda: len(blocks) > 5, "samples")
    assert observer.set({"reset_reason": "the plug was loose"}, node="supervisor") == [(True, "")]
    observer.wait_for(lambda: observer.trigger("reset", rig="supervisor")[0], "the supervisor's reset")
    observer.wait_for(lambda: observer.trigger("reset")[0], "the rig's reset")
    observer.wait_for(lambda: status_of(safe[-1], "rig safe")[2]["stopped"] == "false", "a rig that may move")
    observer.wait_for(lambda: abs(blocks[-1].samples["belt_speed"][-1]) < 0.01, "a reset that starts nothing")
    assert observer.set(point, atomically=True) == [(True, "")]
    observer.wait_for(
        lambda: abs(blocks[-1].samples["preload"][-1] - 80.0) < 0.01 or level() == "emergency stop", "80 N again"
    )
    assert level() in ("ok", "warn"), status_of(states[-1], "supervisor")
    assert [rig.end()[0], supervisor.end()[0]] == [0, 0]
    assert "Traceback" not in rig.errors + supervisor.errors


def test_a_bag_comes_to_its_end_in_a_clear_state_and_begins_anew(bags, processes, observer, config_file, tmp_path):
    driver = tmp_path / "bag.yaml"
    driver.write_text(f"driver: bag\nbag: {bags['virtual'].path}\n")
    files = ["--params-file", str(config_file)]
    hurried = processes.node("rig", *files, *parameters(driver="bag", driver_config=driver, real_time_factor=0.0))
    assert hurried.wait() == 2
    assert "real_time_factor = 0 must be 1: the driver 'bag' keeps its own time" in hurried.errors
    rig = processes.node("rig", *files, *parameters(driver="bag", driver_config=driver))
    blocks, health = observer.follow_samples("daq/samples"), observer.follow("/diagnostics")
    observer.wait_for(lambda: blocks, "samples")
    ((accepted, reason),) = observer.set({"preload": 80.0})
    assert (accepted, "cannot be moved by this rig's driver" in reason) == (False, True)

    def ended():
        state = health_of(health, "rig")
        return state and state[0] == ERROR and "has ended after" in state[1]

    observer.wait_for(ended, "the end of the bag")
    blocks.clear()
    assert observer.trigger("reset")[0]
    observer.wait_for(lambda: blocks, "samples again")
    assert rig.end()[0] == 0
    assert "Traceback" not in rig.errors
