"""The page of a recorded bag, without ROS: read-only, with a slider of time."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

from rich.console import Console

from squeal_rig.errors import SquealRigError
from squeal_rig.page.access import Access, in_url, read_token
from squeal_rig.page.recorded import RecordedPicture
from squeal_rig.page.server import PageServer
from squeal_rig.page.settings import PageSettings
from squeal_rig.page.sound import Sound


def serve_bag(bag: Path, settings: PageSettings, console: Console) -> None:
    """Serve a bag until Ctrl-C.

    Raises:
        RecordingError, ConfigurationError: it is no bag of the rig, or the address cannot be listened on.
        SquealRigError: the server has ended.
    """
    recorded = RecordedPicture(bag)
    access = Access(settings.address, read_token(settings.token_file) if settings.token_file else "", settings.hosts)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    server = PageServer(recorded.picture, Sound(), access, seek=recorded.at, log=console.print)
    server.start(settings.address, settings.port)
    console.print(f"the page of {bag} is at http://{in_url(settings.address)}:{server.port}/, Ctrl-C ends it")
    while not (failure := server.failure) and not ended.wait(0.2):
        pass  # in short waits: Python's handler of a signal runs between them
    server.close()
    if failure:
        raise SquealRigError(failure)
