"""The channel tables: names, units and record layout of `daq/samples`, `truth/samples` and what follows from them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from squeal_rig.errors import RecordingError
from squeal_rig.recording import SampleBlock, samples_from_cdr


@dataclass(frozen=True)
class Channel:
    """One column of a block of samples; `code` is its numpy type code."""

    name: str
    unit: str
    description: str
    code: str = "<f8"


_SEQ = Channel("seq", "", "number of the sample, counted over the whole run", "<u4")
_LATEST = 2.0**31  # a stamp's seconds are an int32
_TIME = Channel("t", "s", "time after the block's stamp")

DAQ_CHANNELS = (
    _TIME,
    Channel("x", "m", "pad displacement along the belt"),
    Channel("y", "m", "pad displacement away from the belt"),
    Channel("arm_left", "N", "force in the left arm, compression positive"),
    Channel("arm_right", "N", "force in the right arm, compression positive"),
    Channel("clip_left", "N", "force in the left clip, compression positive"),
    Channel("clip_right", "N", "force in the right clip, compression positive"),
    Channel("motor_torque", "N m", "torque of the belt's motor"),
    Channel("belt_speed", "m/s", "belt speed in force"),
    Channel("preload", "N", "preload of one arm in force"),
    _SEQ,
)

TRUTH_CHANNELS = (
    _TIME,
    Channel("x", "m", "pad displacement along the belt"),
    Channel("y", "m", "pad displacement away from the belt"),
    Channel("vx", "m/s", "pad velocity along the belt"),
    Channel("vy", "m/s", "pad velocity away from the belt"),
    Channel("normal_force", "N", "normal contact force"),
    Channel("tangential_force", "N", "tangential contact force on the pad"),
    Channel("mu", "", "friction coefficient of the law in force"),
    _SEQ,
)

FRICTION_SAMPLE_CHANNELS = (
    _TIME,
    Channel("mu", "", "Eq. (2.1); zero where not valid"),
    Channel("valid", "", "1 where the denominator of Eq. (2.1) is safely positive", "<u4"),
    _SEQ,
)

FRICTION_WINDOW_CHANNELS = (
    Channel("t_start", "s", "sampled time at the window's start, since sample 0 of the run"),
    Channel("t_end", "s", "sampled time at the window's end"),
    Channel("mu", "", "Eq. (2.2): mean of the valid ratios"),
    Channel("mu_ratio_of_means", "", "mean tangential force over mean denominator of Eq. (2.1)"),
    Channel("valid_share", "", "valid samples over the samples a window should have"),
    Channel("preload", "N", "mean preload in force"),
    Channel("belt_speed", "m/s", "mean belt speed in force"),
    Channel("mu_true", "", "mean of the true friction coefficient; nan where no truth is published"),
    Channel("difference", "", "mu - mu_true"),
    Channel("mu_corrected", "", "ratio of means with the pad's inertia in the denominator; nan in a window with a gap"),
    Channel("mu_standard_error", "", "standard error of mu_ratio_of_means from its scatter within the window"),
    Channel("arm_left", "N", "mean force in the left arm"),
    Channel("arm_right", "N", "mean force in the right arm"),
)
#: What a window of any version has; later ones were appended.
FRICTION_WINDOW_NEEDED = FRICTION_WINDOW_CHANNELS[:9]

#: Force channels that a tare sets to zero.
FORCE_CHANNELS = ("arm_left", "arm_right", "clip_left", "clip_right", "motor_torque")


def record_type(channels: tuple[Channel, ...]) -> np.dtype[np.void]:
    """numpy structured type of one sample; its size is a multiple of 8 bytes."""
    ends = list(accumulate(np.dtype(channel.code).itemsize for channel in channels))
    return np.dtype(
        {
            "names": [channel.name for channel in channels],
            "formats": [channel.code for channel in channels],
            "offsets": [0, *ends[:-1]],
            "itemsize": -(-ends[-1] // 8) * 8,
        }
    )


def block_from_cdr(data: bytes, channels: tuple[Channel, ...]) -> SampleBlock:
    """Block out of a serialised PointCloud2, whoever published it; it may have more columns than these channels.

    Raises:
        RecordingError: no such message, no sample in it, a channel that is missing or not one number, times that no
            stamp can hold.
    """
    block = samples_from_cdr(data)
    names = block.samples.dtype.names or ()
    for channel in channels:
        if channel.name not in names or block.samples.dtype[channel.name].shape:
            raise RecordingError(f"no channel {channel.name} of one number a sample, only {', '.join(names) or 'none'}")
    if len(block.samples) == 0:
        raise RecordingError("a block without a sample")
    if "t" in names:
        t = block.samples["t"]
        if not np.all(np.isfinite(t)):
            raise RecordingError("a block whose times t are not finite")
        first, last = block.stamp_ns * 1e-9 + float(np.min(t)), block.stamp_ns * 1e-9 + float(np.max(t))
        if not (first >= 0.0 and last < _LATEST):
            raise RecordingError(f"a block from {first:g} s to {last:g} s: a stamp lies in 0 to {_LATEST:g} s")
    return block


DAQ_RECORD = record_type(DAQ_CHANNELS)
TRUTH_RECORD = record_type(TRUTH_CHANNELS)
FRICTION_SAMPLE_RECORD = record_type(FRICTION_SAMPLE_CHANNELS)
FRICTION_WINDOW_RECORD = record_type(FRICTION_WINDOW_CHANNELS)
