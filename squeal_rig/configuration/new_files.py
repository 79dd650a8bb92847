"""Files that are written whole or not at all, and never in the place of another one unless that is asked for."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from squeal_rig.configuration.files import reason_of
from squeal_rig.errors import DiskError

_OTHERS_WRITE = 0o002


@contextmanager
def new_file(path: Path, force: bool = False) -> Iterator[Path]:
    """Give a draft beside `path` to write to, which takes its name once it is whole. Links are not followed.

    Folders that are missing are made. With `force` the draft takes the place of what has that name.

    Raises:
        DiskError: there is something of that name already, or the system refuses.
    """
    draft = path.parent / f".{secrets.token_hex(8)}.part"
    try:
        check_free(path, force)
        path.parent.mkdir(parents=True, exist_ok=True)
        os.close(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        try:
            yield draft
            check_free(path, force)  # somebody may have been faster
            os.replace(draft, path)
        finally:
            draft.unlink(missing_ok=True)
    except (OSError, ValueError, RuntimeError) as error:  # of h5py, pyarrow and matplotlib as well
        raise DiskError(f"Cannot write {path}: {reason_of(error)}.") from None


def close_to_strangers() -> None:
    """Let nobody but us and our group write what this process writes from now on, whatever mask it was started with."""
    os.umask(os.umask(_OTHERS_WRITE) | _OTHERS_WRITE)


def check_free(path: Path, force: bool) -> None:
    """Raise DiskError where there is something of that name, and it is not to be overwritten."""
    if os.path.lexists(path) and not force:
        raise DiskError(f"{path} exists already; --force overwrites it.")
