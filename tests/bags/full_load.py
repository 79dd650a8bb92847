"""Publishes everything a full rig does, at its rates, with payloads that can be made again from their numbers.

Run as a script: `full_load.py LOG SECONDS LISTENERS BLOCKS`; the first block comes when so many listen to every topic,
the last one after so long or so many, whichever is first. Each line of LOG is a tick's number and the time [ns] after
it.
"""

import sys
import time
from functools import cache
from pathlib import Path

import numpy as np

BASES = 16
_CHANNELS = {
    "/daq/samples": ("t x y arm_left arm_right clip_left clip_right motor_torque belt_speed preload", "seq"),
    "/truth/samples": ("t x y vx vy normal_force tangential_force mu", "seq"),
    "/friction/samples": ("t mu", "valid seq"),
}
ROWS = 512
#: Blocks per second, as at 51.2 kHz.
RATE = 100
CLOUDS = tuple(_CHANNELS)
SMALL = {"/pad/state": "sensor_msgs/msg/JointState", "/contact/wrench": "geometry_msgs/msg/WrenchStamped"}
ENDLESS = 2**31  # blocks
OTHERS = ("/rosout", "/parameter_events", "/diagnostics")


@cache
def layout(topic):
    """Record type of a topic of samples."""
    floats, counts = (names.split() for names in _CHANNELS[topic])
    names = [*floats, *counts]
    formats = ["<f8"] * len(floats) + ["<u4"] * len(counts)
    offsets = np.cumsum([0, *(int(code[-1]) for code in formats)])
    return np.dtype(
        {"names": names, "formats": formats, "offsets": offsets[:-1], "itemsize": int(-(-offsets[-1] // 8) * 8)}
    )


@cache
def _base(topic, number):
    """Noise of 24 bits, as a converter gives it, in the type of the topic."""
    generator = np.random.default_rng([len(topic), number])
    samples = np.zeros(ROWS, layout(topic))
    for name in samples.dtype.names:
        if samples.dtype[name].kind == "f":
            samples[name] = generator.integers(-(2**23), 2**23, ROWS) * 2.0**-23
    samples["t"] = np.arange(ROWS) / 51200.0
    if "valid" in samples.dtype.names:
        samples["valid"] = 1
    return samples


def payload(topic, number):
    """CDR bytes of block `number` of a topic of samples."""
    from squeal_rig.recording import cdr_from_samples

    samples = _base(topic, number % BASES)
    samples["seq"] = np.arange(number * ROWS, (number + 1) * ROWS) % 2**32
    return cdr_from_samples(samples, 1_700_000_000_000_000_000 + number * 10_000_000)


def small_payload(topic, number):
    """CDR bytes of a small message: noise of its size, valid as its type."""
    stamp = np.array([1_700_000_000 + number // 100, number % 100 * 10_000_000], "<u4").tobytes()
    head = b"\0\1\0\0" + stamp + b"\4\0\0\0rig\0"
    values = np.random.default_rng([len(topic), number]).normal(size=6).tobytes()
    if topic == "/contact/wrench":
        return head + values
    names = b"\2\0\0\0\6\0\0\0pad_x\0\0\0\6\0\0\0pad_y\0\0\0"
    position = b"\2\0\0\0" + b"\0" * (-(len(head) - 4 + len(names) + 4) % 8) + values[:16]
    velocity = b"\2\0\0\0\0\0\0\0" + values[16:32]
    return head + names + position + velocity + b"\0\0\0\0"


def start_load(processes, log, seconds=3600.0, listeners=0, blocks=ENDLESS):
    """Start the full load; its first block comes when so many listen to every topic."""
    return processes.start([sys.executable, Path(__file__), log, seconds, listeners, blocks])


def published(log):
    """(number of blocks published, time of the last one [ns]) as the load's log tells."""
    lines = log.read_text().splitlines() if log.exists() else []
    whole = [line for line in lines if len(line.split()) == 2]
    return (int(whole[-1].split()[0]) + 1, int(whole[-1].split()[1])) if whole else (0, 0)


def main(log, seconds, listeners, blocks):
    """Publish until the time is over, all blocks are out or a signal comes."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState, PointCloud2
    from std_msgs.msg import String

    from squeal_rig.graph.conversions import OK
    from squeal_rig.graph.health import HealthPublisher
    from squeal_rig.graph.leaving import leave_graph

    rclpy.init()
    node = Node("load")
    node.declare_parameter("gain", 0)
    HealthPublisher(node, lambda: (OK, "loading", {}))
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_publisher(String, "/rig/description", latched).publish(String(data="sample_rate: 51200"))
    clouds = {topic: node.create_publisher(PointCloud2, topic, 100) for topic in CLOUDS}
    kinds = {"/pad/state": JointState, "/contact/wrench": WrenchStamped}
    small = {topic: node.create_publisher(kind, topic, 100) for topic, kind in kinds.items()}
    # From a match on, a reliable publisher keeps its last 100 messages for the subscriber, also where that one has not
    # found us yet.
    while any(p.get_subscription_count() < listeners for p in (*clouds.values(), *small.values())):
        rclpy.spin_once(node, timeout_sec=0.1)
    stream = open(log, "w", buffering=1)
    start, number = time.monotonic(), 0
    while time.monotonic() - start < seconds and number < blocks:
        for topic, publisher in clouds.items():
            publisher.publish(payload(topic, number))
        for topic, publisher in small.items():
            publisher.publish(small_payload(topic, number))
        stream.write(f"{number} {time.time_ns()}\n")
        number += 1
        if number % RATE == 0:
            node.get_logger().info(f"{number} blocks")
            node.set_parameters([rclpy.parameter.Parameter("gain", value=number // RATE)])
        while (left := start + number / RATE - time.monotonic()) > 0.0:
            rclpy.spin_once(node, timeout_sec=left)
    rclpy.spin_once(node, timeout_sec=0.5)
    leave_graph(rclpy.get_global_executor(), node)
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), *map(int, sys.argv[3:5]))
