"""Who may speak to the page's server: host, origin and token, checked on every request and every socket."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import os
from collections.abc import Collection
from pathlib import Path
from urllib.parse import urlsplit

from squeal_rig.errors import ConfigurationError

_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
_SHORTEST, _LONGEST = 16, 1024


def is_loopback(address: str) -> bool:
    """Whether an address to listen on is reached from this machine only."""
    found = _ip_address(address)
    return address == "localhost" if found is None else found.is_loopback


def in_url(address: str) -> str:
    """An address as a URL has it: one of IPv6 in brackets."""
    return f"[{address}]" if ":" in address else address


def cookie_name(port: int) -> str:
    """Name of the cookie that a browser shows, instead of the token, to the page that listens on a port.

    Browsers do not tell the ports of a host apart: two pages there would take each other's from them.
    """
    return f"squeal_rig_{port}"


def read_token(file: str) -> str:
    """The token that a file holds.

    Raises:
        ConfigurationError: the file cannot be read, others may read it, or what it holds is no token.
    """
    try:
        with Path(file).open("rb") as stream:
            others = os.fstat(stream.fileno()).st_mode & 0o077
            content = stream.read(_LONGEST + 1)
    except OSError as error:
        raise ConfigurationError(f"token_file {file}: {error.strerror}") from None
    if others:
        raise ConfigurationError(f"token_file {file} can be read by others: chmod 600 it")
    token = content.strip()
    if not _SHORTEST <= len(token) <= _LONGEST or not all(33 <= letter <= 126 for letter in token):
        raise ConfigurationError(
            f"token_file {file} must hold one token of {_SHORTEST} to {_LONGEST} visible ASCII characters"
        )
    return token.decode()


class Access:
    """Judges requests.

    Where there is no token, loopback is the protection from other machines, and host and origin that from pages which
    a browser on this machine shows: one of another origin says so, and one whose name was made to lead here has a host
    that is not ours.

    Where the address stands for all addresses of this machine, every host that is an address is ours: only a name can
    be made to lead here.

    `origins` are those of other pages that may speak to it all the same.

    Raises:
        ConfigurationError: the address is not a loopback address and there is no token.
    """

    def __init__(
        self, address: str, token: str = "", hosts: Collection[str] = (), origins: Collection[str] = ()
    ) -> None:
        if not token and not is_loopback(address):
            raise ConfigurationError(
                f"address {address} can be reached from other machines: that needs a token, give token_file"
            )
        self._token = token.encode()
        self._origins = frozenset(origins)
        found = _ip_address(address)
        self._all_addresses = found is not None and found.is_unspecified
        self._hosts = {*_LOOPBACK_NAMES, address.lower(), *(host.lower() for host in hosts)}

    @property
    def needs_token(self) -> bool:
        """Whether a token is asked for."""
        return bool(self._token)

    @property
    def cookie(self) -> str:
        """What a browser is given for the token: the same after a restart, and not the token."""
        return hmac.new(self._token, b"squeal_rig page", hashlib.sha256).hexdigest()

    def is_token(self, given: str) -> bool:
        """Whether this is the token."""
        return self.needs_token and hmac.compare_digest(given.encode(errors="replace"), self._token)

    def refusal(self, host: str, origin: str | None) -> str:
        """Why a request of that host and origin is refused; empty where it is not."""
        name = _hostname(f"//{host}")
        if name not in self._hosts and not (self._all_addresses and _ip_address(name)):
            return f"host {host!r} is not admitted: name it in the parameter hosts, where it is this server's"
        if origin is not None and origin not in self._origins:
            try:
                parts = urlsplit(origin)
            except ValueError:
                return f"origin {origin!r} cannot be read"
            if parts.scheme not in ("http", "https") or parts.netloc.lower() != host.lower():
                return f"origin {origin!r} is not admitted"
        return ""

    def admits(self, authorization: str, cookie: str) -> bool:
        """Whether a request shows the token, as `Bearer TOKEN` or by the cookie; always where none is asked for."""
        if not self.needs_token:
            return True
        if authorization.startswith("Bearer ") and self.is_token(authorization[len("Bearer ") :].strip()):
            return True
        return hmac.compare_digest(cookie.encode(errors="replace"), self.cookie.encode())


def _ip_address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


def _hostname(url: str) -> str:
    try:
        return (urlsplit(url).hostname or "").lower()
    except ValueError:
        return ""
