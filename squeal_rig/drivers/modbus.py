"""Inverter and preload unit over Modbus TCP: set points out, measured values in, the safe command; needs `pymodbus`."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from typing import Any

from squeal_rig.drivers.hardware_settings import ModbusUnit, Place, Unit, Write
from squeal_rig.drivers.registers import count_of, value_of, words_of
from squeal_rig.errors import DriverError


class NoAnswerError(DriverError):
    """A unit that is not there, or does not answer in time."""


# What a set point in force moves on for at one go, however long ago the last write was [s].
_LONGEST_STEP = 0.2


class Line:
    """One connection to a unit, from one thread at a time; it connects anew after every fault."""

    def __init__(self, name: str, unit: Unit, timeout: float) -> None:
        try:
            from pymodbus.client import ModbusTcpClient
        except ImportError as error:
            raise DriverError(
                f"Modbus needs the package pymodbus: pip install 'squeal_rig[hardware]' ({error})"
            ) from None
        logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)  # told in our sentences
        self._make = ModbusTcpClient
        self._client: Any = None
        self._name, self._unit, self._timeout = name, unit, timeout
        self._lock = threading.Lock()

    def write(self, write: Write) -> None:
        """Write a value [register's unit]; DriverError where it is not accepted."""
        register, name = self._unit.registers[write.register], f"{self._name}.{write.register}"
        words = words_of(register, write.value, name)
        if register.write_function == 6:
            self._ask(name, "write_register", register.address, words[0])
        else:
            self._ask(name, "write_registers", register.address, words)

    def read(self, register_name: str) -> float:
        """A register's value in its unit; DriverError where there is none."""
        register, name = self._unit.registers[register_name], f"{self._name}.{register_name}"
        call = "read_holding_registers" if register.kind == "holding" else "read_input_registers"
        answer = self._ask(name, call, register.address, count=count_of(register))
        return value_of(register, answer.registers, name)

    def connect(self) -> None:
        """Connect where that is not so; DriverError where nobody answers."""
        with self._lock:
            self._connected()

    def close(self) -> None:
        """Let go of the connection."""
        with self._lock:
            self._drop()

    def _ask(self, name: str, call: str, *arguments: Any, **more: Any) -> Any:
        with self._lock:
            client = self._connected()
            try:
                answer = getattr(client, call)(*arguments, device_id=self._unit.connection.device_id, **more)
            except Exception as error:  # its own kinds, and what a socket raises
                self._drop()
                raise NoAnswerError(f"{name}: {self._where()} does not answer ({_short(error)})") from None
            if answer.isError():
                code = getattr(answer, "exception_code", None)
                raise DriverError(f"{name}: {self._where()} refuses (Modbus exception {code})")
            return answer

    def _connected(self) -> Any:
        connection: ModbusUnit = self._unit.connection
        if self._client is None:
            client = self._make(connection.host, port=connection.port, timeout=self._timeout, retries=0)
            if not client.connect():
                client.close()
                raise NoAnswerError(f"{self._name}: no Modbus unit answers at {self._where()}")
            self._client = client
        return self._client

    def _drop(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def _where(self) -> str:
        return f"{self._unit.connection.host}:{self._unit.connection.port}"


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


class SafeLine:
    """A connection that carries the safe command of one unit and nothing else, so that it is never busy."""

    def __init__(self, name: str, unit: Unit, timeout: float) -> None:
        self._line, self._unit = Line(name, unit, timeout), unit

    def connect(self) -> None:
        """Connect ahead of time; DriverError where nobody answers."""
        self._line.connect()

    def command(self) -> None:
        """Every write of the unit's list `safe`; each once more on a new connection where the old one has died.

        A unit that does not answer on the new one either is given up: waiting for it write by write would take longer
        than those have who watch over the stop.

        Raises:
            DriverError: one was not accepted; those after one that was refused were sent all the same.
        """
        errors = []
        for write in self._unit.safe:
            try:
                self._line.write(write)
            except DriverError:
                try:
                    self._line.write(write)
                except NoAnswerError as error:
                    errors.append(str(error))
                    break
                except DriverError as error:
                    errors.append(str(error))
        if errors:
            raise DriverError("; ".join(errors))

    def close(self) -> None:
        """Let go of the connection."""
        self._line.close()


class UnitThread:
    """Writes set points to one unit and reads it, in a thread of its own.

    Args:
        name: of the unit, for sentences.
        unit: its registers.
        set_points: parameter of the rig -> its register here.
        measured: registers to read.
        rates: parameter -> fastest change of what is commanded [units/s]; it begins at nothing.
        interval: time between two rounds [s].
    """

    def __init__(
        self,
        name: str,
        unit: Unit,
        set_points: Mapping[str, Place],
        measured: frozenset[str],
        rates: Mapping[str, float],
        interval: float,
    ) -> None:
        self._name, self._unit, self._interval = name, unit, interval
        self._line = Line(name, unit, unit.connection.timeout)
        self._set_points, self._measured, self._rates = set_points, measured, rates
        self._targets: dict[str, float] = {}
        self._commanded = dict.fromkeys(set_points, 0.0)
        self._written: dict[str, float] = {}
        self._started = False
        self._safe, self._ended = threading.Event(), threading.Event()
        self._heard, self._error = time.monotonic(), ""
        self.values: dict[str, float] = {}
        self._thread = threading.Thread(target=self._run, name=f"modbus {name}", daemon=True)

    def start(self) -> None:
        """Connect and begin; DriverError where nobody answers."""
        self._line.connect()
        self._heard = time.monotonic()
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join(5.0)
        self._line.close()

    def aim(self, targets: Mapping[str, float]) -> None:
        """What the set points are to come to, from now on."""
        self._targets = {name: targets[name] for name in self._set_points}

    def hold_safe(self) -> None:
        """From now on nothing but the safe command is written, again in every round."""
        self._safe.set()

    def fault(self, stale_after: float) -> str:
        """A sentence where it has not answered, or has refused, for that long [s], with how long that is."""
        error, age = self._error, time.monotonic() - self._heard
        return f"{error}: without success for {age:.2f} s" if error and age > stale_after else ""

    def _run(self) -> None:
        last = time.monotonic()
        while not self._ended.is_set():
            now = time.monotonic()
            try:
                self._round(min(now - last, _LONGEST_STEP))
            except Exception as error:
                self._error = str(error) if isinstance(error, DriverError) else f"{self._name}: {_short(error)}"
                self._written.clear()  # what has arrived of it nobody knows
            else:
                self._heard, self._error = time.monotonic(), ""
            last = now
            self._ended.wait(max(0.0, self._interval - (time.monotonic() - now)))

    def _round(self, dt: float) -> None:
        if self._safe.is_set():
            self._write_all(self._unit.safe)
        elif self._targets:
            self._move(dt)
            if self._safe.is_set():  # it came while we wrote: ours may have been the later one
                self._write_all(self._unit.safe)
        for register in self._measured:
            self.values[register] = self._line.read(register)

    def _move(self, dt: float) -> None:
        if not self._started:
            self._write_all(self._unit.start)
            self._started = True
        for name, goal in self._targets.items():
            most, here = self._rates[name] * dt, self._commanded[name]
            value = goal if abs(goal - here) <= most else here + (most if goal > here else -most)
            if self._written.get(name) != value and not self._safe.is_set():
                self._line.write(Write(self._set_points[name].register, value))
                self._written[name] = value
            self._commanded[name] = value

    def _write_all(self, writes: tuple[Write, ...]) -> None:
        for write in writes:
            self._line.write(write)
