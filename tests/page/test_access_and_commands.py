"""Who may speak to the page, and what may be asked: judged without a server."""

import json
import math

import pytest

from squeal_rig.errors import ConfigurationError
from squeal_rig.page.access import Access, read_token
from squeal_rig.page.commands import MOST_BYTES, PLAIN, Command, RefusedError, command_of, settable
from tests.command_line import in_this_process

TOKEN = "a-token-that-is-long-enough"


@pytest.mark.parametrize("address", ["0.0.0.0", "::", "192.0.2.1", "rig.example"])
def test_another_address_than_loopback_needs_a_token(address):
    with pytest.raises(ConfigurationError, match="token"):
        Access(address)
    assert Access(address, TOKEN).needs_token


@pytest.mark.parametrize("address", ["127.0.0.1", "127.0.0.2", "::1", "localhost"])
def test_loopback_needs_none(address):
    assert not Access(address).needs_token


@pytest.mark.parametrize(
    ("host", "origin", "refused"),
    [
        ("127.0.0.1:8460", None, False),
        ("127.0.0.1:8460", "http://127.0.0.1:8460", False),
        ("localhost:8460", "http://localhost:8460", False),
        ("[::1]:8460", "http://[::1]:8460", False),
        ("127.0.0.1:8460", "http://127.0.0.1:9999", True),
        ("127.0.0.1:8460", "http://evil.example", True),
        ("127.0.0.1:8460", "null", True),
        ("127.0.0.1:8460", "file://127.0.0.1:8460", True),
        ("127.0.0.1:8460", "http://[", True),
        ("evil.example:8460", "http://evil.example:8460", True),  # a name that was made to lead here
        ("", None, True),
        ("[", None, True),
    ],
)
def test_host_and_origin_must_be_the_page_s(host, origin, refused):
    assert bool(Access("127.0.0.1").refusal(host, origin)) == refused


@pytest.mark.parametrize("address", ["0.0.0.0", "::"])
def test_where_every_address_is_listened_on_a_host_that_is_one_is_the_page_s_and_a_foreign_name_is_not(address):
    access = Access(address, TOKEN, hosts=("rig.example",))
    for host in ("192.0.2.7:8460", "[2001:db8::7]:8460", "localhost:8460", "rig.example:8460"):
        assert not access.refusal(host, f"http://{host}")
    for host in ("evil.example:8460", "192.0.2.7.evil.example:8460", "", "[", "0x7f.1:8460"):
        assert access.refusal(host, f"http://{host}")
    assert access.refusal("192.0.2.7:8460", "http://192.0.2.7:9999")
    assert Access("192.0.2.7", TOKEN).refusal("192.0.2.8:8460", None)  # of one address only that


def test_names_given_to_the_command_reach_the_node_as_a_list(monkeypatch):
    pytest.importorskip("rclpy")
    pytest.importorskip("aiohttp")
    from squeal_rig.session import page as session

    given = []
    monkeypatch.setattr(session, "main", lambda words: given.extend(words) or 0)
    code, _, errors = in_this_process("page", "--host", "rig.example", "--host", "other.example")
    assert code == 0, errors
    assert given[-2:] == ["-p", 'hosts:=["rig.example", "other.example"]']


def test_the_token_or_the_cookie_made_of_it_admits_and_nothing_else():
    access = Access("0.0.0.0", TOKEN)
    assert access.admits(f"Bearer {TOKEN}", "")
    assert access.admits("", access.cookie)
    assert TOKEN not in access.cookie
    for authorization, cookie in (("", ""), (TOKEN, ""), ("Bearer ", ""), ("Bearer x", ""), ("", TOKEN), ("", "é")):
        assert not access.admits(authorization, cookie)
    assert Access("0.0.0.0", TOKEN + "x").cookie != access.cookie
    assert Access("0.0.0.0", TOKEN).cookie == access.cookie  # a browser stays known after a restart


def test_a_token_file_is_read_only_where_it_is_one(tmp_path):
    file = tmp_path / "token"
    for content, mode, word in ((TOKEN, 0o644, "others"), ("short", 0o600, "characters"), ("é" * 30, 0o600, "ASCII")):
        file.write_text(content, encoding="utf-8")
        file.chmod(mode)
        with pytest.raises(ConfigurationError, match=word) as refused:
            read_token(str(file))
        assert TOKEN not in str(refused.value)
    file.write_text(TOKEN + "\n", encoding="utf-8")
    file.chmod(0o600)
    assert read_token(str(file)) == TOKEN
    with pytest.raises(ConfigurationError, match="No such file"):
        read_token(str(tmp_path / "none"))


def asked(control=True, **content):
    return command_of(json.dumps(content).encode(), control)


def test_every_command_is_understood():
    for name in PLAIN:
        assert asked(do=name) == Command(name)
    assert asked(do="set", values={"preload": 60}) == Command("set", {"preload": 60.0})
    assert asked(do="supervisor_reset", reason=" seen to ") == Command("supervisor_reset", text="seen to")
    assert asked(do="springs_fitted", name="stiff ") == Command("springs_fitted", text="stiff")


@pytest.mark.parametrize("name", [*PLAIN, "set", "supervisor_reset", "springs_fitted"])
def test_a_page_that_is_read_only_takes_the_emergency_stop_alone(name):
    if name == "emergency_stop":
        assert asked(control=False, do=name) == Command(name)
    else:
        with pytest.raises(RefusedError, match="read-only"):
            asked(control=False, do=name, values={"preload": 60.0}, reason="why")


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"preload": 1e9}, "2000 N"),
        ({"preload": -1}, "out of bounds"),
        ({"preload": "60"}, "not a number"),
        ({"preload": True}, "not a number"),
        ({"preload": None}, "not a number"),
        ({"preload": [60]}, "not a number"),
        ({"prelaod": 60.0}, "did you mean 'preload'"),
        ({"mass": 1.0}, "unknown parameter"),  # a machine constant
        ({"driver": "evil"}, "unknown parameter"),
        ({"friction_direction": "sideways"}, "one of"),
        ({"preload": 60.0, "belt_speed": 99.0}, "20 m/s"),
        ({}, "nothing to set"),
        ([], "nothing to set"),
        (None, "nothing to set"),
    ],
)
def test_a_value_that_is_not_declared_so_is_refused_with_a_sentence(values, word):
    with pytest.raises(RefusedError, match=word):
        asked(do="set", values=values)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff\xfe",
        b"null",
        b"[]",
        b'"reset"',
        b"{}",
        b'{"do": 1}',
        b'{"do": ["reset"]}',
        b'{"do": "__class__"}',
        b'{"do": "reset", "values": {}}',
        b'{"do": "set", "values": {"preload": NaN}}',
        b'{"do": "set", "values": {"preload": 1e999}}',
        b'{"do": "supervisor_reset"}',
        b'{"do": "springs_fitted", "reason": "stiff"}',
        b'{"do": "supervisor_reset", "reason": "a\\nb"}',
        b'{"do": "supervisor_reset", "reason": "' + b"x" * 201 + b'"}',
        b"[" * 4000,
        b" " * (MOST_BYTES + 1),
    ],
)
def test_what_is_no_command_is_refused(text):
    with pytest.raises(RefusedError):
        command_of(text, True)


def test_what_can_be_set_has_bounds_that_are_finite():
    for name, found in settable().items():
        if found.kind is not str:
            assert math.isfinite(found.upper - found.lower), name
