"""Settings of the page."""

from __future__ import annotations

from dataclasses import dataclass

from squeal_rig.configuration.declared import Declared, quantity


@dataclass(frozen=True)
class PageSettings(Declared):
    """Settings of the node `page`."""

    address: str = quantity(
        "127.0.0.1", "address to listen on; any but a loopback address needs token_file", read_only=True
    )
    port: int = quantity(8460, "port to listen on; 0 takes a free one", lower=0, upper=65535, read_only=True)
    token_file: str = quantity(
        "", "file that holds the token which every request must show; none is asked for when empty", read_only=True
    )
    hosts: tuple[str, ...] = quantity(
        (), "names, besides address, under which browsers may reach the page", read_only=True
    )
    control: bool = quantity(False, "take commands; where false, only the emergency stop", read_only=True)
    frame_rate: float = quantity(
        15.0, "most pictures sent to a browser a second", unit="Hz", lower=1.0, upper=60.0, read_only=True
    )


@dataclass(frozen=True)
class FoxgloveSettings(Declared):
    """Settings of the node `foxglove`."""

    address: str = quantity(
        "127.0.0.1", "address to listen on; any but a loopback address needs token_file", read_only=True
    )
    port: int = quantity(8765, "port to listen on; 0 takes a free one", lower=0, upper=65535, read_only=True)
    token_file: str = quantity(
        "", "file that holds the token which every connection must show; none is asked for when empty", read_only=True
    )
    hosts: tuple[str, ...] = quantity(
        (), "names, besides address, under which the server may be reached", read_only=True
    )
    origins: tuple[str, ...] = quantity(
        ("https://app.foxglove.dev",),
        "pages whose scripts may connect; who names no origin is no page, and may",
        read_only=True,
    )
    control: bool = quantity(
        False, "take parameters and services; where false, only the emergency stop", read_only=True
    )
    topics: tuple[str, ...] = quantity(("*",), "topics to offer, patterns with * and ?", read_only=True)
