"""Whether compiled code that lies on disk is ours to run: whoever writes into that folder decides what we execute."""

from __future__ import annotations

import os
import stat
from functools import cache
from pathlib import Path

_ROOT = 0


@cache
def why_not_trusted(folder: Path, source: Path) -> str | None:
    """The reason why code from `folder` may not be loaded, None where it may.

    Numba keeps pickles, which are arbitrary code. A folder is ours where it and all in it that numba reads belong to
    us, to root, or to the owner of `source` (whose code we run anyhow), and nobody else may write into it or put
    another one in its place.
    """
    owners = {_ROOT, os.geteuid(), source.stat().st_uid}
    try:
        for path in (folder, *folder.glob("*.nb[ic]")):
            if (reason := _open_to_others(path, owners)) is not None:
                return reason
        for parent in folder.resolve().parents:
            # In a sticky folder, as /tmp, nobody takes away what belongs to another.
            if not parent.stat().st_mode & stat.S_ISVTX and (reason := _writable_by_all(parent)) is not None:
                return reason
    except OSError as error:  # gone or closed to us since it was listed
        return f"{error.filename} cannot be looked at: {error.strerror}"
    return None


def _open_to_others(path: Path, owners: set[int]) -> str | None:
    status = path.lstat()
    if stat.S_ISLNK(status.st_mode) and path.suffix in (".nbi", ".nbc"):
        return f"{path} is a link"
    status = path.stat()
    if status.st_uid not in owners:
        return f"{path} belongs to user {status.st_uid}, who is neither you nor the owner of the package"
    # A group of the owner's own number is his alone, as most distributions set it up.
    if status.st_mode & stat.S_IWGRP and status.st_gid != status.st_uid:
        return f"{path} can be written by the group {status.st_gid}"
    return _writable_by_all(path)


def _writable_by_all(path: Path) -> str | None:
    return f"{path} can be written by everybody" if path.stat().st_mode & stat.S_IWOTH else None
