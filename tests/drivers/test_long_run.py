"""Half a minute without a gap, stamps the device's; `python -m tests.drivers.long_run --minutes 5` for five."""

import pytest

from .conftest import needs_extra
from .long_run import measure


@pytest.mark.slow
def test_half_a_minute_has_no_gap_and_every_stamp_is_the_devices(tmp_path, measured):
    needs_extra()
    blocks, lost, missing, sentences, worst, latest, mean = measure(tmp_path, 0.5)
    measured(f"{blocks} blocks; stamps within {worst} ns; {1e3 * mean:.1f} ms old, {1e3 * latest:.1f} ms at worst")
    assert (lost, missing, sentences) == (0, 0, [])
    assert worst < 1_000_000  # [ns]
    assert blocks > 0
