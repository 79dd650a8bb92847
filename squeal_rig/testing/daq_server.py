"""An openDAQ server with signals of ours, over native streaming; needs the package `opendaq`."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.drivers.streams import opendaq_package

#: Ticks of the device's clock in one sample.
TICKS = 1000
# How often the server looks for packets to send [ms]; openDAQ's default of 20 would send blocks in pairs.
_POLLING = 5


def free_port() -> int:
    """A TCP port of this machine that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def serve(instance: Any, port: int) -> None:
    """Serve everything that an instance of openDAQ has over native streaming."""
    opendaq = opendaq_package()
    kind = opendaq.IServerType.cast_from(instance.available_server_types["OpenDAQNativeStreaming"])
    settings = kind.create_default_config()
    settings.set_property_value("NativeStreamingPort", port)
    settings.set_property_value("StreamingDataPollingPeriod", _POLLING)
    instance.add_server("OpenDAQNativeStreaming", settings)


class SignalServer:
    """Signals (name -> unit) at one rate, each with the same clock, served on a port of this machine."""

    def __init__(self, signals: Mapping[str, str], rate: int, port: int) -> None:
        opendaq = self._daq = opendaq_package()
        builder = opendaq.InstanceBuilder()
        builder.global_log_level = opendaq.LogLevel.Off
        self._instance: Any = builder.build()
        folder = next(item for item in self._instance.items if item.local_id == "Sig")
        signals_folder, context = opendaq.IFolderConfig.cast_from(folder), self._instance.context
        ticks = opendaq.DataDescriptorBuilder()
        ticks.name, ticks.sample_type = "time", opendaq.SampleType.Int64
        ticks.unit = opendaq.Unit(-1, "s", "seconds", "time")
        ticks.tick_resolution = opendaq.Ratio(1, rate * TICKS)
        ticks.rule = opendaq.LinearDataRule(TICKS, 0)
        ticks.origin = "1970-01-01T00:00:00Z"
        self._ticks = ticks.build()
        self._time = opendaq.SignalWithDescriptor(context, self._ticks, folder, "time", None)
        signals_folder.add_item(self._time)
        self._signals: dict[str, tuple[Any, Any]] = {}
        for name, unit in signals.items():
            values = opendaq.DataDescriptorBuilder()
            values.name, values.sample_type = name, opendaq.SampleType.Float64
            values.unit = opendaq.Unit(-1, unit, unit, name)
            descriptor = values.build()
            signal = opendaq.SignalWithDescriptor(context, descriptor, folder, name, None)
            signal.domain_signal = self._time
            signals_folder.add_item(signal)
            self._signals[name] = signal, descriptor
        serve(self._instance, port)

    def send(self, tick: int, values: Mapping[str, NDArray[np.float64]]) -> None:
        """Send samples (n,) of every signal, the first one taken at `tick`."""
        count = len(next(iter(values.values())))
        domain = self._daq.DataPacket(self._ticks, count, tick)
        for name, (signal, descriptor) in self._signals.items():
            packet = self._daq.DataPacketWithDomain(domain, descriptor, count, 0)
            np.frombuffer(packet.raw_data, dtype=np.float64)[:] = values[name]
            signal.send_packet(packet)
        self._time.send_packet(domain)
