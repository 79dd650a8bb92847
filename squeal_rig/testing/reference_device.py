"""openDAQ's own reference device, served over native streaming: `python -m squeal_rig.testing.reference_device`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

from squeal_rig.drivers.streams import opendaq_package
from squeal_rig.errors import SquealRigError
from squeal_rig.testing.daq_server import free_port, serve


def main(args: Sequence[str] | None = None) -> int:
    """Serve it until the process is ended; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m squeal_rig.testing.reference_device", description=__doc__)
    parser.add_argument("--port", type=int, default=17421, help="port of native streaming; 0 is any free one")
    parser.add_argument("--sample-rate", type=float, default=10000.0, help="samples per second; its clock has 1 us")
    parser.add_argument("--channels", type=int, default=2, help="analogue channels AI0, AI1, ...")
    given = parser.parse_args(args)
    port = given.port or free_port()
    try:
        opendaq = opendaq_package()
    except SquealRigError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    builder = opendaq.InstanceBuilder()
    builder.global_log_level = opendaq.LogLevel.Off
    builder.set_root_device("daqref://device0")
    instance = builder.build()
    device = instance.root_device
    device.set_property_value("NumberOfChannels", given.channels)
    device.set_property_value("GlobalSampleRate", given.sample_rate)
    device.set_property_value("AcquisitionLoopTime", 10)
    serve(instance, port)
    sys.stdout.write(f"reference device: daq.ns://127.0.0.1:{port}\n")
    sys.stdout.flush()
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        return 0


if __name__ == "__main__":
    sys.exit(main())
