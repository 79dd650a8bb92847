"""The recorder on a disk that stalls once: `stalled_recorder.py MARK SECONDS --ros-args ...`.

The file MARK is made when the stall begins.
"""

import sys
import time
from pathlib import Path

from squeal_rig.nodes.recorder import main
from squeal_rig.recording.mcap_file import McapFile


def stall(mark, seconds, after=20):
    """Let the write after so many others take that long."""
    write, count = McapFile._append, 0

    def slow(self, data, **options):
        nonlocal count
        count += 1
        if count == after:
            mark.touch()
            time.sleep(seconds)
        write(self, data, **options)

    McapFile._append = slow


if __name__ == "__main__":
    stall(Path(sys.argv[1]), float(sys.argv[2]))
    sys.exit(main(sys.argv[3:]))
