"""ROS domains that nobody else on this machine is on."""

import fcntl
import os
import socket
import tempfile
from contextlib import contextmanager
from pathlib import Path

# Domains above 101 use ports that the kernel hands out to anybody.
_HIGHEST = 101
# DDS: the ports of a domain begin at 7400 + 250 * domain; the first participant's own one is 10 further on.
_FIRST_PORT, _PORTS_A_DOMAIN, _OFFSETS = 7400, 250, (0, 10)


def _quiet(domain):
    for offset in _OFFSETS:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", _FIRST_PORT + _PORTS_A_DOMAIN * domain + offset))
            except OSError:
                return False
    return True


@contextmanager
def private_domain():
    """A free domain, locked against other test runs until the block ends."""
    for step in range(_HIGHEST):
        domain = 1 + (os.getpid() + 37 * step) % _HIGHEST
        with (Path(tempfile.gettempdir()) / f"squeal_rig_tests_domain_{domain}.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            if _quiet(domain):
                yield domain
                return
    raise RuntimeError("every ROS domain of this machine is in use")
