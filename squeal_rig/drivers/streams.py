"""Signals of an openDAQ device as packets of numbers with the device's time; needs the package `opendaq`."""

from __future__ import annotations

import importlib
import re
import socket
import time
from collections.abc import Iterator, Mapping
from datetime import datetime, timezone
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from squeal_rig.drivers.alignment import Values
from squeal_rig.errors import DriverError

# openDAQ's names of sample types -> numpy's.
_TYPES = {
    "Float32": "<f4",
    "Float64": "<f8",
    "Int8": "i1",
    "Int16": "<i2",
    "Int32": "<i4",
    "Int64": "<i8",
    "UInt8": "u1",
    "UInt16": "<u2",
    "UInt32": "<u4",
    "UInt64": "<u8",
}
_CONNECT = 1.0  # longest wait for the device's port [s]
_SETTLES = 0.1  # time for packets on their way once nobody reads them any more [s]
_PORT = re.compile(r"^daq\.\w+://(?P<host>[^/:]+|\[[^]]+\]):(?P<port>\d+)")


class Packet(NamedTuple):
    """Samples of one signal: time of the first [s since 1970], None where it is damaged; arrival is now."""

    name: str
    time: Fraction | None
    values: Values


def opendaq_package() -> Any:
    """The package `opendaq`, whose stubs are no valid Python in places; DriverError where it is not installed."""
    try:
        return importlib.import_module("opendaq")
    except ImportError as error:
        raise DriverError(f"openDAQ needs its package: pip install 'squeal_rig[hardware]' ({error})") from None


class Streams:
    """A device's signals, being read.

    Args:
        connection: openDAQ's connection string.
        signals: our name -> the device's name of a signal.
        rate: samples per second that every signal must have.

    Raises:
        DriverError: no package, no device, no such signal.
    """

    def __init__(self, connection: str, signals: Mapping[str, str], rate: int) -> None:
        opendaq = self._daq = opendaq_package()
        self._connection, self._rate = connection, rate
        _knock(connection)
        builder = opendaq.InstanceBuilder()
        builder.global_log_level = opendaq.LogLevel.Off  # what is wrong is told in our sentences
        self._instance: Any = builder.build()
        try:
            self._device: Any = self._instance.add_device(connection)
        except RuntimeError as error:
            raise DriverError(f"no openDAQ device at {connection}: {error}") from None
        there = list(self._device.get_signals_recursive())
        self._readers = {name: opendaq.PacketReader(_found(there, wanted)) for name, wanted in signals.items()}
        self._layouts: dict[str, _Layout] = {}

    def packets(self) -> Iterator[Packet]:
        """What has arrived since, signal by signal; never waits.

        Raises:
            DriverError: a signal is not one number a sample at the rig's rate.
        """
        data = self._daq.PacketType.Data
        for name, reader in self._readers.items():
            for packet in reader.read_all():
                if packet.type == data:
                    yield self._packet(name, self._daq.IDataPacket.cast_from(packet))
                else:  # a new descriptor, or a gap, which the times tell as well
                    self._layouts.pop(name, None)

    def close(self) -> None:
        """Let go of the device.

        openDAQ was seen to crash, once in some hundreds of times, where a device went while packets of its readers
        still arrived: those have a moment to come to their end first.
        """
        self._readers.clear()
        if self._device is not None:
            time.sleep(_SETTLES)
            device, self._device = self._device, None
            self._instance.remove_device(device)
        self._instance = None

    def _packet(self, name: str, packet: Any) -> Packet:
        layout = self._layouts.get(name)
        if layout is None:
            layout = self._layouts[name] = _layout(name, packet, self._rate)
        values = np.frombuffer(packet.data, dtype=layout.dtype).astype(np.float64)
        count = int(packet.sample_count)
        if len(values) != count:
            raise DriverError(f"signal {name} has {len(values) / max(count, 1):g} numbers a sample: it must be one")
        return Packet(name, _time(packet.domain_packet, count, layout), values)


class _Layout(NamedTuple):
    """How a signal's bytes and ticks are to be read: seconds a tick, ticks a sample, its start and origin [s]."""

    dtype: np.dtype[Any]
    resolution: Fraction
    delta: Fraction
    linear: bool
    start: int
    origin: Fraction


def _knock(connection: str) -> None:
    """See whether somebody listens, where the connection string names a port: openDAQ itself does not say why not."""
    found = _PORT.match(connection)
    if found is None:
        return
    try:
        socket.create_connection((found["host"].strip("[]"), int(found["port"])), timeout=_CONNECT).close()
    except (OSError, OverflowError) as error:
        raise DriverError(f"no openDAQ device answers at {connection}: {error}") from None


def _found(signals: list[Any], wanted: str) -> Any:
    """The one signal of that local id, or whole id on the device; a streaming device writes * for /."""
    names = [str(signal.local_id).replace("*", "/") for signal in signals]
    whole = [name.strip("/") for name in names]
    for ids in (whole, [str(signal.global_id).strip("/") for signal in signals], [n.split("/")[-1] for n in names]):
        found = [signal for signal, name in zip(signals, ids, strict=True) if name == wanted.strip("/")]
        if len(found) > 1:
            raise DriverError(f"the device has {len(found)} signals {wanted!r}: give the whole id of one")
        if found:
            return found[0]
    there = ", ".join(sorted(name.split("/")[-1] for name in names)) or "none"
    raise DriverError(f"the device has no signal {wanted!r}: there are {there}")


def _layout(name: str, packet: Any, rate: int) -> _Layout:
    descriptor, domain = packet.data_descriptor, packet.domain_packet
    kind = str(descriptor.sample_type).rpartition(".")[2]
    if kind not in _TYPES:
        raise DriverError(f"signal {name} has samples of {kind}: they must be numbers")
    if domain is None:
        raise DriverError(f"signal {name} comes without any time")
    ticks = domain.data_descriptor
    resolution = Fraction(int(ticks.tick_resolution.numerator), int(ticks.tick_resolution.denominator))
    linear = str(ticks.rule.type).endswith("Linear")
    delta = 1 / (rate * resolution)
    start = 0
    if linear:
        delta, start = Fraction(int(ticks.rule.parameters["delta"])), int(ticks.rule.parameters["start"])
    if delta * resolution * rate != 1:
        raise DriverError(
            f"signal {name} has {float(1 / (delta * resolution)):.10g} samples per second, and the rig's sample_rate is"
            f" {rate} Hz: nothing is resampled here, set the device to that rate"
        )
    return _Layout(np.dtype(_TYPES[kind]), resolution, delta, linear, start, _origin(str(ticks.origin or "")))


def _origin(text: str) -> Fraction:
    """Origin of the ticks in s since 1970; a device that names none counts from there."""
    try:
        moment = datetime.fromisoformat(text.replace("Z", "+00:00"))
    except ValueError:
        return Fraction(0)
    zoned = moment if moment.tzinfo is not None else moment.replace(tzinfo=timezone.utc)
    since = zoned - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return Fraction(since.days * 86400 + since.seconds) + Fraction(since.microseconds, 10**6)


def _time(domain: Any, count: int, layout: _Layout) -> Fraction | None:
    """Time of a packet's first sample; None where there is none or it contradicts itself."""
    if domain is None or int(domain.sample_count) != count or count == 0:
        return None
    if layout.linear:
        if domain.offset is None:
            return None
        return layout.origin + (int(domain.offset) + layout.start) * layout.resolution
    ticks = np.frombuffer(domain.data, dtype=np.int64)
    if len(ticks) != count:
        return None
    expected = int(ticks[0]) + np.arange(count) * float(layout.delta)
    if np.max(np.abs(ticks - expected)) > 1.0:
        return None
    return layout.origin + int(ticks[0]) * layout.resolution
