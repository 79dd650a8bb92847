"""The recorder on a disk that nobody else fills: `recorder_on_small_disk.py FOLDER MEGABYTES --ros-args ...`.

So much is free as the bags in FOLDER leave of it.
"""

import os
import sys
from pathlib import Path
from types import SimpleNamespace

from squeal_rig.nodes.recorder import main


def shrink(folder, size):
    """Let the operating system say of every file that its disk has `size` bytes, and that bags in `folder` fill it."""

    def status(_handle):
        used = sum(path.stat().st_size for path in folder.rglob("*.mcap"))
        return SimpleNamespace(f_bavail=max(0, size - used), f_frsize=1)

    os.fstatvfs = status


if __name__ == "__main__":
    shrink(Path(sys.argv[1]), round(float(sys.argv[2]) * 1e6))
    sys.exit(main(sys.argv[3:]))
