import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2.metadata import dump_qos_v8, parse_qos

from squeal_rig.errors import RecordingError
from squeal_rig.recording import INFINITE_NS, QosProfile, qos_from_yaml, qos_to_yaml
from squeal_rig.recording.qos_yaml import POLICIES

# What yaml-cpp dumps for rclcpp::QoS(1).transient_local() through rosbag2_storage/qos.cpp (Jazzy).
LATCHED = """\
- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""

durations = st.integers(0, INFINITE_NS)
profiles = st.builds(
    QosProfile,
    history=st.sampled_from(POLICIES["history"]),
    depth=st.integers(0, 2**31 - 1),
    reliability=st.sampled_from(POLICIES["reliability"]),
    durability=st.sampled_from(POLICIES["durability"]),
    deadline_ns=durations,
    lifespan_ns=durations,
    # rosbags does not know manual_by_node, which ROS 2 deprecated
    liveliness=st.sampled_from([name for name in POLICIES["liveliness"] if name != "manual_by_node"]),
    liveliness_lease_ns=durations,
    avoid_ros_namespace_conventions=st.booleans(),
)


def test_a_latched_profile_is_written_as_rosbag2_writes_it():
    assert qos_to_yaml([QosProfile(depth=1, durability="transient_local")]) == LATCHED


def test_no_profile_is_an_empty_list():
    assert qos_to_yaml([]) == "[]"
    assert qos_from_yaml("[]") == qos_from_yaml("") == ()


@given(st.lists(profiles, max_size=3))
def test_profiles_come_back_from_their_yaml(offered):
    assert qos_from_yaml(qos_to_yaml(offered)) == tuple(offered)


@given(profiles)
def test_rosbags_reads_the_same_profile(profile):
    (read,) = parse_qos(qos_to_yaml([profile]))
    assert (read.history.name.lower(), read.depth) == (profile.history, profile.depth)
    assert read.reliability.name.lower() == profile.reliability
    assert read.durability.name.lower() == profile.durability
    assert read.liveliness.name.lower() == profile.liveliness
    assert read.avoid_ros_namespace_conventions == profile.avoid_ros_namespace_conventions
    for duration, expected in (
        (read.deadline, profile.deadline_ns),
        (read.lifespan, profile.lifespan_ns),
        (read.liveliness_lease_duration, profile.liveliness_lease_ns),
    ):
        assert duration.sec * 10**9 + duration.nsec == expected


@given(profiles)
def test_the_numbers_of_older_bags_are_read(profile):
    older = dump_qos_v8(parse_qos(qos_to_yaml([profile])))
    assert qos_from_yaml(older) == (profile,)


def test_the_infinity_of_an_old_middleware_is_read_as_infinite():
    old = LATCHED.replace("sec: 9223372036\n    nsec: 854775807", "sec: 2147483647\n    nsec: 4294967295", 1)
    # Foxy's Fast DDS: 0x7FFFFFFF s and 0xFFFFFFFF ns (rosbag2_storage/qos.cpp)
    assert qos_from_yaml(old)[0].deadline_ns == INFINITE_NS


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "5",
        "- 5",
        "- {}",
        LATCHED.replace("keep_last", "keep_some"),
        LATCHED.replace("depth: 1", "depth: -1"),
        LATCHED.replace("keep_last", "[]"),
        LATCHED.replace("history: keep_last", "history:"),
        LATCHED.replace("automatic", "{a: b}"),
    ],
)
def test_text_that_is_no_qos_is_refused_with_a_sentence(text):
    with pytest.raises(RecordingError, match="QoS"):
        qos_from_yaml(text)
