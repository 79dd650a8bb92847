"""The command line in this process, which saves a second a time beside a process of its own."""

import contextlib
import io
import sys
from unittest.mock import patch

from squeal_rig.cli import main


def in_this_process(*arguments):
    """(exit code, what was written to stdout, to stderr) of `squeal-rig` with these arguments."""
    output, errors = io.StringIO(), io.StringIO()
    with (
        patch.object(sys, "argv", ["squeal-rig", *map(str, arguments)]),
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(errors),
    ):
        try:
            code = main()
        except SystemExit as end:
            code = end.code
    return code, output.getvalue(), errors.getvalue()
