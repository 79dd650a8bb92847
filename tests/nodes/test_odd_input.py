"""What anybody may publish on the rig's topics: nodes refuse it, say so on `/diagnostics`, and work on."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from squeal_rig.instruments.channels import DAQ_RECORD, FRICTION_WINDOW_RECORD, TRUTH_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model import RigParameters
from tests.graph.statuses import health_of, status_of

pytest.importorskip("rclpy")

CONSUMERS = ("friction_estimator", "stability", "squeal_detector")
_DESCRIPTION = RigDescription(RigParameters.preset("yavuz_sen_2023"), preset="yavuz_sen_2023")


def _block(record, count=512, **values):
    samples = np.zeros(count, record)
    for name, value in values.items():
        samples[name] = value
    return samples


def _daq(count=512, **values):
    usual = {"preload": 50.0, "belt_speed": 1.0, "t": np.arange(count) / 51200, "seq": np.arange(count)}
    return _block(DAQ_RECORD, count, **{**usual, **values})


def _without(name):
    kept = [field for field in DAQ_RECORD.names if field != name]
    return np.zeros(512, [(field, DAQ_RECORD[field].str) for field in kept])


ODD_BLOCKS = {
    "no_points": _daq(0),
    "one_point": _daq(1),
    "other_fields": np.zeros(64, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")]),
    "no_preload": _without("preload"),
    "no_seq": _without("seq"),
    "no_x": _without("x"),
    "no_torque": _without("motor_torque"),
    "all_nan": _daq(**{name: np.nan for name in DAQ_RECORD.names if name != "seq"}),
    "all_inf": _daq(**{name: np.inf for name in DAQ_RECORD.names if name not in ("seq", "t")}),
    "negative_preload": _daq(preload=-3.0),
    "preload_out_of_bounds": _daq(preload=1e6),
    "belt_backwards": _daq(belt_speed=-1.0),
    "seq_all_the_same": _daq(seq=7),
    "time_beyond_all_bounds": _daq(t=1e308),
    "seq_leaps": _daq(seq=np.arange(512) + 3_000_000_000),
}
ODD_WINDOWS = {
    "no_points": _block(FRICTION_WINDOW_RECORD, 0),
    "enormous_mu": _block(FRICTION_WINDOW_RECORD, 1, mu_ratio_of_means=1e9),
    "infinite_mu": _block(FRICTION_WINDOW_RECORD, 1, mu_ratio_of_means=np.inf),
    "other_fields": np.zeros(1, [("x", "<f8")]),
}
_TEXT = _DESCRIPTION.to_yaml()
ODD_DESCRIPTIONS = {
    "empty": "",
    "no_yaml": "{[",
    "a_word": "hello",
    "half_of_it": _TEXT[: len(_TEXT) // 2],
    "text_for_the_rate": _TEXT.replace("sample_rate: 51200", "sample_rate: fast"),
    "no_rate": _TEXT.replace("sample_rate: 51200", "sample_rate: 0"),
    "rate_of_minus_one": _TEXT.replace("sample_rate: 51200", "sample_rate: -1"),
    "rate_of_one": _TEXT.replace("sample_rate: 51200", "sample_rate: 1"),
    "infinite_drum": _TEXT.replace("drum_radius: 0.05", "drum_radius: .inf"),
    "no_drum": _TEXT.replace("drum_radius: 0.05", "drum_radius: 0.0"),
    "negative_mass": _TEXT.replace("mass: 11.499", "mass: -1.0"),
    "no_equilibrium": _DESCRIPTION.with_parameters({"k1": 0.0, "k2": 0.0, "k3": 0.0, "k4": 0.0}).to_yaml(),
    "unknown_key": _TEXT + "colour: red\n",
    "a_number_as_a_key": _TEXT + "1: 2\n",
    "a_list_as_a_key": _TEXT + "? [1, 2]\n: 3\n",
    "a_number_of_400_digits": _TEXT.replace("mass: 11.499", "mass: " + 400 * "9"),
    "a_tare_of_400_digits": _TEXT + "tare_x: " + 400 * "9" + "\n",
    "a_tare_that_is_no_number": _TEXT + "tare_x: .nan\n",
    "a_list_for_the_driver": _TEXT.replace('driver: "virtual"', "driver: [virtual]"),
    "a_number_for_the_truth": _TEXT.replace("publishes_truth: true", "publishes_truth: 3"),
}


@dataclass
class Talk:
    """Estimators without a rig, and the means to speak in its place."""

    observer: object
    nodes: dict
    publishers: dict
    health: object = field(repr=False)
    summaries: object = field(repr=False)

    def block(self, topic, samples, stamp=10**18):
        from squeal_rig.graph.conversions import cloud

        self.publishers[topic].publish(cloud(samples, stamp))

    def describe(self, text):
        from std_msgs.msg import String

        self.publishers["rig/description"].publish(String(data=text))

    def check_alive(self):
        """Every node reports its health after this moment, and none has ended."""
        self.health.clear()
        for name, node in self.nodes.items():
            self.observer.wait_for(
                lambda name=name, node=node: health_of(self.health, name) or not node.running, f"health of {name}"
            )
            assert node.running, node.errors
            assert "Traceback" not in node.errors


@pytest.fixture(scope="module")
def talk(compiled, processes, observer, config_file):
    topics = ("daq/samples", "truth/samples", "friction/windows", "rig/description")
    publishers = {topic: observer.publisher(topic) for topic in topics}
    talk = Talk(
        observer,
        nodes={name: processes.node(name, "--params-file", str(config_file)) for name in CONSUMERS},
        publishers=publishers,
        health=observer.follow("/diagnostics"),
        summaries=observer.follow("stability/summary"),
    )
    for topic in ("daq/samples", "rig/description"):
        observer.wait_for(
            lambda topic=topic: talk.publishers[topic].get_subscription_count() == len(CONSUMERS),
            f"listeners to {topic}",
        )
    talk.describe(_TEXT)
    observer.wait_for(lambda: talk.summaries, "a summary of the description")
    return talk


@pytest.mark.parametrize("kind", ["blocks", "truth", "windows", "descriptions", "bytes"])
def test_nodes_live_through_odd_messages(talk, observer, kind):
    if kind == "blocks":
        for block in ODD_BLOCKS.values():
            talk.block("daq/samples", block)
        for stamp in (2**31 - 1, -1):  # [s]
            talk.block("daq/samples", _daq(1000), stamp * 10**9 + 999_999_999)
    elif kind == "truth":
        for block in (*ODD_BLOCKS.values(), _block(TRUTH_RECORD, 512, mu=np.nan), _block(TRUTH_RECORD, 0)):
            talk.block("truth/samples", block)
    elif kind == "windows":
        for window in ODD_WINDOWS.values():
            talk.block("friction/windows", window)
            talk.block("daq/samples", _daq(preload=60.0))
    elif kind == "descriptions":
        for text in ODD_DESCRIPTIONS.values():
            talk.describe(text)
            talk.block("daq/samples", _daq())
            observer.spin(0.02)
    else:
        for data in (b"\x00", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + bytes(range(256)), b"\xff" * 4096):
            for topic in ("daq/samples", "truth/samples", "friction/windows"):
                talk.publishers[topic].publish(data)
    talk.check_alive()


def test_refused_blocks_are_counted_on_diagnostics(talk, observer):
    key = "rejected messages"
    for name in CONSUMERS:
        talk.health.clear()
        state = observer.wait_for(lambda name=name: health_of(talk.health, name), f"health of {name}")
        before = int(state[2][key])
        talk.block("daq/samples", ODD_BLOCKS["other_fields"])
        observer.wait_for(
            lambda name=name, before=before: int(health_of(talk.health, name)[2][key]) > before,
            f"one more of the {key} of {name}",
        )


def test_after_all_that_a_good_block_and_a_good_description_count(talk, observer):
    changed = _DESCRIPTION.with_parameters({"preload": 77.0})
    talk.describe(changed.to_yaml())

    def told():
        talk.block("daq/samples", _daq(preload=66.0))
        set_point = status_of(talk.summaries[-1], "stability: set point")
        in_force = status_of(talk.summaries[-1], "stability: in force")
        return in_force and (float(set_point[2]["preload [N]"]), float(in_force[2]["preload [N]"])) == (77.0, 66.0)

    observer.wait_for(told, "a summary of set point and in force")
