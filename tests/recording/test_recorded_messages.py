import pytest
from hypothesis import given
from hypothesis import strategies as st

from squeal_rig import __version__
from squeal_rig.errors import RecordingError
from squeal_rig.recording import MessageSchema, as_mapping, decoder_of, provenance

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


@pytest.fixture(scope="module")
def diagnostics(types):
    """A DiagnosticArray with one status, made by rosbags."""
    value = types.types["diagnostic_msgs/msg/KeyValue"](key="k_cr", value="4.57e7")
    status = types.types["diagnostic_msgs/msg/DiagnosticStatus"](
        level=1, name="stability", message="unstable", hardware_id="", values=[value]
    )
    stamp = types.types["builtin_interfaces/msg/Time"](sec=-1, nanosec=500)
    header = types.types["std_msgs/msg/Header"](stamp=stamp, frame_id="rig")
    message = types.types[DIAGNOSTICS](header=header, status=[status])
    return bytes(types.serialize_cdr(message, DIAGNOSTICS))


def test_a_nested_message_is_decoded_field_by_field(schema_for, diagnostics):
    assert as_mapping(decoder_of(schema_for(DIAGNOSTICS))(diagnostics)) == {
        "header": {"stamp": {"sec": -1, "nanosec": 500}, "frame_id": "rig"},
        "status": [
            {
                "level": 1,
                "name": "stability",
                "message": "unstable",
                "hardware_id": "",
                "values": [{"key": "k_cr", "value": "4.57e7"}],
            }
        ],
    }


def test_arrays_of_numbers_come_back_exactly(types, schema_for):
    import numpy as np

    name = "std_msgs/msg/Float64MultiArray"
    layout = types.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    numbers = np.array([0.1, -1e300, 5e-324, np.inf])
    data = bytes(types.serialize_cdr(types.types[name](layout=layout, data=numbers), name))
    assert list(decoder_of(schema_for(name))(data).data) == numbers.tolist()


@given(st.binary(max_size=80))
def test_bytes_that_are_no_such_message_are_refused_with_a_sentence(schema_for, noise):
    decode, refusal = decoder_of(schema_for(DIAGNOSTICS)), None
    try:
        decoded = decode(noise)
    except RecordingError as error:
        refusal = str(error)
    assert f"bytes are no {DIAGNOSTICS}" in refusal if refusal else isinstance(decoded.status, list)


def test_a_truncated_message_is_refused(schema_for, diagnostics):
    with pytest.raises(RecordingError, match=f"bytes are no {DIAGNOSTICS}"):
        decoder_of(schema_for(DIAGNOSTICS))(diagnostics[:-8])


@pytest.mark.parametrize(
    "schema",
    [
        MessageSchema("far_away/msg/Thing", "", encoding=""),
        MessageSchema("far_away/msg/Thing", "no definition !"),
    ],
)
def test_a_bag_without_a_readable_definition_is_told(schema):
    with pytest.raises(RecordingError, match="definition of far_away/msg/Thing"):
        decoder_of(schema)


def test_provenance_is_texts():
    facts = provenance()
    assert all(isinstance(value, str) and value for value in facts.values())
    assert facts["squeal_rig"] == __version__
    assert facts["started_utc"].endswith("+00:00")


def test_provenance_names_neither_host_nor_folder():
    import os
    import platform

    text = "\n".join(provenance().values())
    assert platform.node() not in text.split()
    assert os.getcwd() not in text
