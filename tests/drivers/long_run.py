"""Minutes of the driver `opendaq` on the twin: gaps, and stamps against the device's own clock.

python -m tests.drivers.long_run --minutes 5
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from squeal_rig.drivers.hardware import HardwareRig
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model import RigParameters

from .conftest import serve_twin

PARAMETERS = RigParameters(damping_x=20.0, damping_y=20.0)


def measure(folder, minutes):
    """Blocks, samples lost and missing, sentences, worst error of a stamp [ns], worst and mean age when read [s]."""
    twin = serve_twin(folder)
    try:
        text = twin.config.read_text().replace("set_points:", '  counter: {signal: counter, unit: ""}\nset_points:')
        twin.config.write_text(text)
        first = int(twin.line.split("sample 0 at ")[1].split()[0])
        settings = RigSettings(driver="opendaq", driver_config=str(twin.config))
        rig = HardwareRig()
        rig.open(PARAMETERS, settings)
        blocks = lost = missing = worst = 0
        latest = total = 0.0
        following, sentences = None, []
        end = time.monotonic() + 60.0 * minutes
        while time.monotonic() < end:
            reading = rig.read(PARAMETERS)
            if reading is None:
                time.sleep(0.002)
                continue
            counter = reading.daq["counter"]
            if following is not None:
                lost += reading.lost
                missing += int(counter[0]) - following
            following = int(counter[-1]) + 1
            expected = first + round(counter[0] * 1e9 / settings.sample_rate)
            worst = max(worst, abs(reading.stamp - expected))
            late = time.time() - reading.stamp * 1e-9 - settings.block_size / settings.sample_rate
            latest, total = max(latest, late), total + late
            sentences += reading.warnings
            blocks += 1
        rig.close()
        return blocks, lost, missing, sentences, worst, latest, total / blocks
    finally:
        twin.kill()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=0.5)
    with tempfile.TemporaryDirectory() as folder:
        blocks, lost, missing, sentences, worst, latest, mean = measure(Path(folder), parser.parse_args().minutes)
    sys.stdout.write(
        f"{blocks} blocks, {lost} samples lost, {missing} missing by the device's counter, {len(sentences)} warnings;\n"
        f"stamps within {worst} ns of the device's; read {1e3 * mean:.1f} ms after the last sample was taken,"
        f" {1e3 * latest:.1f} ms at worst\n"
    )
    for sentence in sentences[:10]:
        sys.stdout.write(f"  {sentence}\n")
    return 0 if not (lost or missing or sentences) and worst < 1_000_000 else 1


if __name__ == "__main__":
    sys.exit(main())
