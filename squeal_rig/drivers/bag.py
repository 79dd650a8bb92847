"""Driver `bag`: a recorded run as if it were the rig; nobody can move it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from squeal_rig.configuration.declared import Declared, declarations, quantity
from squeal_rig.errors import DriverError, ParameterError
from squeal_rig.instruments.channels import DAQ_CHANNELS, TRUTH_CHANNELS, Channel, record_type
from squeal_rig.instruments.driver import Capabilities, Reading, Samples
from squeal_rig.instruments.driver_config import declared_from, load_driver_config
from squeal_rig.instruments.numbering import Numbering
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.parameters import RUN_TIME_PARAMETERS, RigParameters
from squeal_rig.recording import Bag
from squeal_rig.samples.blocks import TRUTH, RecordedBlock, recorded_blocks, rig_topic

_NS = 10**9


@dataclass(frozen=True)
class BagDriverSettings(Declared):
    """Settings of the driver `bag`."""

    bag: str = quantity("", "recorded run to give again: the bag's folder or its .mcap file", read_only=True)
    longest_pause: float = quantity(
        10.0,
        "longest time without samples that is kept as it was recorded; a longer one is cut to it",
        unit="s",
        lower=0.01,
        upper=86400.0,
        read_only=True,
    )


class BagRig:
    """Driver `bag`: blocks of a recorded run in their order and at their pace, with their truth, from now on.

    Samples are those of the recording, bit for bit, a tare that was taken then included. What was lost then is lost
    again; where the recorded rig was stopped or started anew, so is time, and a warning says so. Set points cannot be
    moved, and the pad cannot be hit. Nothing stands behind it that could be unsafe. After the last block `read` raises
    that the bag has ended; `reset` begins it anew.
    """

    def __init__(self) -> None:
        self._settings = BagDriverSettings()
        self._rig_settings = RigSettings()
        self._bag: Bag | None = None
        self._knows_truth = False
        self._blocks: Iterator[RecordedBlock] | None = None
        self._next: RecordedBlock | None = None
        self._numbering = Numbering()
        self._begun: int | None = None
        self._zero = self._due = self._given = self._lost = 0
        self._warnings: list[str] = []

    @classmethod
    def check_config(cls, path: str) -> None:
        """Check a file of settings; ConfigurationError or ParameterError where something is wrong with it."""
        settings = declared_from(BagDriverSettings, path, load_driver_config(path, "bag"))
        if not settings.bag:
            raise ParameterError(f"{path}: bag = '' names no bag: the driver 'bag' needs a recorded run")

    def capabilities(self, settings: RigSettings) -> Capabilities:
        """It can nothing but be watched, and knows the truth where the recording has it.

        Raises:
            ConfigurationError, ParameterError, RecordingError: its settings or the bag cannot be read.
        """
        if not settings.driver_config:
            raise DriverError("driver_config = '' names no file: the driver 'bag' needs one, with the key bag")
        self.check_config(settings.driver_config)
        content = load_driver_config(settings.driver_config, "bag")
        self._settings = declared_from(BagDriverSettings, settings.driver_config, content)
        bag = self._bag = Bag(self._settings.bag)
        topic = rig_topic(bag, TRUTH)
        knows_truth = topic is not None and bag.topics[topic].message_count > 0
        return Capabilities(frozenset(), knows_truth=knows_truth, can_hit=False, keeps_time=True)

    def open(self, parameters: RigParameters, settings: RigSettings) -> None:
        """Open the bag; the rig's constants and sample rate have to be those it was recorded with.

        Raises:
            DriverError, RecordingError: they are not, or it cannot be read.
        """
        self._knows_truth = self.capabilities(settings).knows_truth
        self._rig_settings = settings
        self._begin()
        first = self._next
        if first is None:
            raise DriverError(f"{self._settings.bag} holds no block of samples")
        if first.rig.sample_rate != settings.sample_rate:
            raise DriverError(
                f"sample_rate = {settings.sample_rate} Hz, but {self._settings.bag} was recorded at"
                f" {first.rig.sample_rate} Hz"
            )
        for name in declarations(RigParameters).keys() - RUN_TIME_PARAMETERS:
            here, there = getattr(parameters, name), getattr(first.rig.parameters, name)
            if here != there:
                raise DriverError(f"{name} = {here}, but the rig of {self._settings.bag} was one of {there}")

    def close(self) -> None:
        """Let go of the bag."""
        self._blocks = self._next = None

    def reset(self) -> None:
        """Begin the recording anew."""
        self._opened()
        self._begin()

    def impact(self, impulse_x: float, impulse_y: float) -> None:
        """Refused: what was recorded is what there is."""
        raise DriverError("a recorded run cannot be given an impact")

    def read(self, in_force: RigParameters) -> Reading | None:
        """The next recorded block once it is due, else None.

        Raises:
            DriverError: the bag has ended.
            RecordingError: a message of it is damaged.
        """
        self._opened()
        block = self._next
        if block is None:
            raise DriverError(f"{self._settings.bag} has ended after {self._given} blocks")
        now = time.monotonic_ns()
        if self._begun is None:
            self._begun, self._zero = now, time.time_ns()
        if now < self._begun + self._due + self._length(block):
            return None
        reading = self._reading(block)
        self._given += 1
        self._advance(block)
        return reading

    def make_safe(self) -> None:
        """Nothing is commanded, and nothing could be."""

    # --- the recording

    def _begin(self) -> None:
        if self._bag is None:
            self._bag = Bag(self._settings.bag)
        self._blocks = recorded_blocks(self._bag)
        self._numbering = Numbering()
        self._begun = None
        self._zero = self._due = self._given = self._lost = 0
        self._warnings = []
        self._next = next(self._blocks, None)
        if self._next is not None:
            self._number(self._next)

    def _advance(self, last: RecordedBlock) -> None:
        """Take up the block after `last`, and when it is due: as long after it as it was recorded."""
        assert self._blocks is not None
        following = self._next = next(self._blocks, None)
        if following is None:
            return
        before = self._numbering.lost_samples
        restarted = self._number(following)
        self._lost = self._numbering.lost_samples - before
        step, length = following.stamp - last.stamp, self._length(last)
        longest = length + round(self._settings.longest_pause * _NS)
        if restarted:
            self._warnings.append("the recorded rig was started anew here")
        if step < length // 2:
            self._warnings.append(f"recorded stamps run back here, by {(length - step) / _NS:g} s")
            step = length
        elif step > longest:
            self._warnings.append(f"a pause of {step / _NS:g} s of the recording is cut to {longest / _NS:g} s")
            step = longest
        self._due += step

    def _length(self, block: RecordedBlock) -> int:
        return len(block.daq) * _NS // self._rig_settings.sample_rate

    def _number(self, block: RecordedBlock) -> bool:
        return self._numbering.take(block.stamp, block.daq, self._rig_settings.sample_rate)[1]

    def _reading(self, block: RecordedBlock) -> Reading:
        size, most = len(block.daq), self._rig_settings.block_size
        if size > most:
            raise DriverError(
                f"block {self._given} of {self._settings.bag} has {size} samples, but a block of this rig {most}"
            )
        daq = _copied(block.daq, DAQ_CHANNELS)
        truth = None
        if self._knows_truth and block.truth is not None and len(block.truth) == size:
            truth = _copied(block.truth, TRUTH_CHANNELS)
        elif self._knows_truth:
            self._warnings.append("a block without its truth in the recording")
        warnings, lost = tuple(self._warnings), self._lost
        self._warnings, self._lost = [], 0
        return Reading(daq, truth, warnings, stamp=self._zero + self._due, lost=lost)

    def _opened(self) -> None:
        if self._blocks is None:
            raise DriverError("the driver is not open: open it before use")


def _copied(samples: Samples, channels: tuple[Channel, ...]) -> Samples:
    """Our channels of recorded samples, in a record of our own that can be written."""
    copy = np.zeros(len(samples), record_type(channels))
    for channel in channels:
        copy[channel.name] = samples[channel.name]
    return copy
