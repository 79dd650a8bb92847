"""A twin of the hardware: an openDAQ device with the virtual rig's physics, a Modbus server that moves it.

    python -m squeal_rig.testing.twin [--daq-port N] [--modbus-port N] [--write-config FILE]

Signals, in micrometres, newtons and so on as a front end has them, are those of `config/drivers/twin.yaml`; `counter`
numbers the samples, and the line that is printed says when sample 0 was taken. Modbus device 1 is the belt's inverter,
device 2 the preload unit. `--fault` damages the times of the device for a while, again and again.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from struct import pack, unpack
from typing import Any

import numpy as np

from squeal_rig.configuration.files import config_directory, read_text
from squeal_rig.errors import SquealRigError
from squeal_rig.instruments.actuators import slewed
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model.parameters import RigParameters
from squeal_rig.testing.daq_server import TICKS, SignalServer, free_port

DAQ_PORT, MODBUS_PORT = 17420, 15020
FAULTS = ("none", "stuck", "back", "ahead", "lost")
#: Signals -> unit; what comes in micrometres there is in m here.
_SIGNALS = {
    "x": "um",
    "y": "um",
    "arm_left": "N",
    "arm_right": "N",
    "clip_left": "N",
    "clip_right": "N",
    "counter": "",
}
_MICRO = ("x", "y")
_BEHIND = 2.0  # a twin that was stopped for longer has lost the samples [s]
_EVERY, _FOR = 50, 3  # a fault begins every so many blocks and lasts so many
# Registers of the inverter: control word, speed command and actual speed [mm/s], torque as float32 in two.
_CONTROL, _SPEED, _ACTUAL, _TORQUE, _INVERTER = 0, 1, 2, 3, 5
# Registers of the preload unit: enable, command and measured force as float32, low word first.
_ENABLE, _COMMAND, _FORCE, _PRELOAD_UNIT = 0, 1, 3, 5


class Registers:
    """What Modbus sees of the twin; written by its server's thread, read by the physics', and the other way round."""

    def __init__(self) -> None:
        self.inverter, self.preload_unit = [0] * _INVERTER, [0] * _PRELOAD_UNIT

    def targets(self) -> tuple[float, float]:
        """Preload [N] and belt speed [m/s] that are commanded; nothing where a unit is not enabled."""
        unit, inverter = list(self.preload_unit), list(self.inverter)
        (force,) = unpack(">f", pack(">HH", unit[_COMMAND + 1], unit[_COMMAND]))
        (speed,) = unpack(">h", pack(">H", inverter[_SPEED]))
        return (force if unit[_ENABLE] == 1 else 0.0, 1e-3 * speed if inverter[_CONTROL] == 1 else 0.0)

    def show(self, preload: float, belt_speed: float, torque: float) -> None:
        """What the units measure [N, m/s, N m]."""
        high, low = unpack(">HH", pack(">f", preload))
        self.preload_unit[_FORCE : _FORCE + 2] = [low, high]
        self.inverter[_ACTUAL : _ACTUAL + 1] = unpack(">H", pack(">h", round(1e3 * belt_speed)))
        self.inverter[_TORQUE : _TORQUE + 2] = unpack(">HH", pack(">f", torque))


def serve_modbus(registers: Registers, port: int) -> threading.Thread:
    """Serve the registers on a port of this machine, from a thread of its own, once it listens."""
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    def device(number: int, block: list[int]) -> Any:
        async def action(
            _function: int, start: int, address: int, count: int, current: list[int], written: list[int] | None
        ) -> None:
            first = address - start
            if written is None:
                current[first : first + count] = block[address : address + count]
            else:
                block[address : address + count] = written

        data = [SimData(0, values=list(block), datatype=DataType.REGISTERS)]
        return SimDevice(number, simdata=data, action=action)

    listening = threading.Event()

    async def run() -> None:
        devices = [device(1, registers.inverter), device(2, registers.preload_unit)]
        server = ModbusTcpServer(devices, address=("127.0.0.1", port))
        await server.serve_forever(background=True)
        listening.set()
        await asyncio.Event().wait()

    thread = threading.Thread(target=lambda: asyncio.run(run()), name="modbus server", daemon=True)
    thread.start()
    if not listening.wait(10.0):
        raise SquealRigError(f"the Modbus server cannot listen on port {port}")
    return thread


def run_twin(daq_port: int, modbus_port: int, settings: RigSettings, p: RigParameters, fault: str) -> None:
    """Sample the virtual rig in real time, for ever."""
    registers = Registers()
    rig = VirtualRig()
    in_force = p.replace(preload=0.0, belt_speed=0.0)
    rig.open(in_force, settings)
    serve_modbus(registers, modbus_port)
    server = SignalServer(_SIGNALS, settings.sample_rate, daq_port)
    size, rate = settings.block_size, settings.sample_rate
    first_tick = time.time_ns() * rate * TICKS // 10**9
    sys.stdout.write(
        f"twin: daq.ns://127.0.0.1:{daq_port}, Modbus 127.0.0.1:{modbus_port},"
        f" sample 0 at {first_tick * 10**9 // (rate * TICKS)} ns\n"
    )
    sys.stdout.flush()
    begun, number, block = time.monotonic(), 0, 0
    while True:
        preload, speed = registers.targets()
        goal = p.replace(preload=float(np.clip(preload, 0.0, 2000.0)), belt_speed=float(np.clip(speed, 0.0, 20.0)))
        in_force = slewed(in_force, goal, settings, 1.0 / BLOCKS_PER_SECOND)
        reading = rig.read(in_force)
        daq, first = reading.daq, number + reading.lost  # instruments may lose samples
        wait = begun + (number + size) / rate - time.monotonic()
        if wait > 0.0:
            time.sleep(wait)
        elif wait < -_BEHIND:
            late = int(-wait * rate)
            number, first = number + late, first + late
        values = {name: (1e6 if name in _MICRO else 1.0) * daq[name] for name in _SIGNALS if name != "counter"}
        values["counter"] = np.arange(first, number + size, dtype=np.float64)
        tick = _damaged(fault, block, first_tick + first * TICKS, size)
        if len(daq):
            registers.show(*(float(daq[name].mean()) for name in ("preload", "belt_speed", "motor_torque")))
            if tick is not None:
                server.send(tick, values)
        number += size
        block += 1


def _damaged(fault: str, block: int, tick: int, size: int) -> int | None:
    """The tick as the fault tells it; None where the block is lost."""
    phase = block % _EVERY - (_EVERY - _FOR)
    if fault == "none" or phase < 0:
        return tick
    if fault == "stuck":
        return tick - phase * size * TICKS
    if fault == "lost":
        return None
    return tick + (1 if fault == "ahead" else -1) * 3600 * BLOCKS_PER_SECOND * size * TICKS


def twin_config(daq_port: int, modbus_port: int) -> str:
    """The driver's YAML for a twin on these ports: `config/drivers/twin.yaml` with them in it."""
    text = read_text(config_directory() / "drivers" / "twin.yaml")
    return text.replace(str(DAQ_PORT), str(daq_port)).replace(str(MODBUS_PORT), str(modbus_port))


def main(args: Sequence[str] | None = None) -> int:
    """Run the twin; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m squeal_rig.testing.twin", description="A twin of the hardware.")
    parser.add_argument("--daq-port", type=int, default=DAQ_PORT, help="port of native streaming; 0 is any free one")
    parser.add_argument("--modbus-port", type=int, default=MODBUS_PORT, help="port of Modbus TCP; 0 is any free one")
    parser.add_argument("--sample-rate", type=int, default=51200, help="samples per second [Hz]")
    parser.add_argument("--preset", default="yavuz_sen_2023", help="preset of the rig behind it")
    parser.add_argument("--instruments", default="ideal", help="data sheets that its signals are seen through")
    parser.add_argument("--fault", choices=FAULTS, default="none", help="what is wrong with its times now and then")
    parser.add_argument("--write-config", type=Path, help="file to write the driver's settings for this twin to")
    given = parser.parse_args(args)
    daq_port, modbus_port = given.daq_port or free_port(), given.modbus_port or free_port()
    try:
        settings = RigSettings(sample_rate=given.sample_rate, instruments=given.instruments)
        # Where the belt stands it brakes the pad: with the preset's sliding friction a squeal would outlive every stop.
        p = RigParameters.preset(given.preset).replace(damping_x=20.0, damping_y=20.0, friction_direction="slip")
        if given.write_config is not None:
            given.write_config.write_text(twin_config(daq_port, modbus_port), encoding="utf-8")
        run_twin(daq_port, modbus_port, settings, p, given.fault)
    except (SquealRigError, ImportError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    except KeyboardInterrupt:
        pass  # Ctrl-C is how it ends
    return 0


if __name__ == "__main__":
    sys.exit(main())
