"""Driver `opendaq`: acquisition from an openDAQ device, belt inverter and preload unit over Modbus TCP."""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import suppress
from fractions import Fraction

from squeal_rig.drivers.alignment import Aligner, Values
from squeal_rig.drivers.hardware_settings import ChannelSource, HardwareSettings, load_hardware, place_of
from squeal_rig.drivers.modbus import SafeLine, UnitThread
from squeal_rig.drivers.streams import Streams
from squeal_rig.errors import DriverError, ParameterError, SquealRigError
from squeal_rig.instruments.driver import Capabilities, Reading
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.model.parameters import RigParameters

_NS = 10**9
_LATEST = 2**31 * _NS  # a stamp's seconds are an int32
_POLL = 0.002  # [s]
# A process that was stopped for a while has not seen the device silent: silence grows by no more than this a round [s].
_ROUND = 0.02
# Longest wait for a device's first samples [s].
_FIRST = 10.0
# Waits for a unit that accepts connections and does not answer the safe command: two, each a little longer than asked.
_WAITS = 3.0
_MOST_WARNINGS = 16
_TOO_SLOW = "samples were dropped: the rig asks for them more slowly than they come"
_FAR_APART = 1_000_000  # [s] beyond which a clock's difference is not told in figures


class HardwareRig:
    """Driver `opendaq`: what a rig of hardware measures, in blocks with the device's own time; set points by Modbus.

    Acquisition and every Modbus unit have threads of their own: `read` takes what is ready and never waits. A device
    that is silent, or a unit that does not answer, for `stale_after` is commanded safe as far as it can be reached, and
    `read` raises with its age; `reset` connects everything anew and begins again from nothing in force.
    """

    def __init__(self) -> None:
        self._rig: RigSettings | None = None
        self._config: HardwareSettings | None = None
        self._streams: Streams | None = None
        self._units: list[UnitThread] = []
        self._safe_lines: dict[str, SafeLine] = {}
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._ready: deque[Reading] = deque()
        self._open = False
        self._safe = False
        self._stops = 0  # safe commands so far
        self._fault = ""
        self._warnings: list[str] = []
        self._forgotten = 0
        self.faults: dict[str, int] = {}

    @classmethod
    def check_config(cls, path: str) -> None:
        """Check a file of settings; ConfigurationError or ParameterError where something is wrong with it."""
        load_hardware(path)

    @classmethod
    def make_safe_from_outside(cls, settings: RigSettings) -> None:
        """Command the safe state on connections of its own: for a process beside the rig's, which may hang.

        Raises:
            DriverError: a unit did not accept it; those after it are commanded all the same.
        """
        config = load_hardware(settings.driver_config)
        lines = {name: SafeLine(name, unit, config.acquisition.safe_timeout) for name, unit in config.units.items()}
        try:
            _command_all(lines)
        finally:
            for line in lines.values():
                line.close()

    def capabilities(self, settings: RigSettings) -> Capabilities:
        """It moves what its file has registers for; nobody knows the truth, and it cannot hit."""
        self._config, self._rig = load_hardware(settings.driver_config), settings
        longest = _WAITS * self._config.acquisition.safe_timeout
        if settings.supervisor_required and longest >= settings.watchdog_timeout:
            raise ParameterError(
                f"{settings.driver_config}: safe_timeout = {self._config.acquisition.safe_timeout:g} s lets a safe"
                f" command last {longest:g} s, and watchdog_timeout = {settings.watchdog_timeout:g} s is shorter"
            )
        return Capabilities(
            frozenset(self._config.set_points),
            knows_truth=False,
            can_hit=False,
            keeps_time=True,
            not_measured=frozenset(self._config.fixed),
        )

    def open(self, parameters: RigParameters, settings: RigSettings) -> None:
        """Connect to the device and the units, and wait for the first samples. Nothing is commanded before `read`.

        Raises:
            DriverError: somebody does not answer, a signal is not there or has another rate.
        """
        self.close()
        self.capabilities(settings)
        self._begin(self._stops)
        self._open = True

    def close(self) -> None:
        """Command the safe state, then let go of everything."""
        commanded = self._open and not self._safe
        self._open = False
        try:
            if commanded:
                self._command()
        finally:
            self._end()

    def reset(self) -> None:
        """Connect everything anew; set points count again and come into force from nothing."""
        if not self._open:
            raise DriverError("the driver is not open: open it before use")
        stops = self._stops  # one that comes from here on is not undone
        self._end()
        try:
            self._begin(stops)
        except SquealRigError as error:
            self._fault = str(error)
            with suppress(SquealRigError):  # units that can be reached stand; others are told again by `close`
                self._command()
            raise

    def impact(self, impulse_x: float, impulse_y: float) -> None:
        """Refused: a hammer is for hands."""
        raise DriverError("this rig cannot give the pad an impact: use an impact hammer")

    def read(self, in_force: RigParameters) -> Reading | None:
        """The next block that is ready; what is in force goes to the units.

        Raises:
            DriverError: the device or a unit has been silent for too long, or something failed in a thread.
        """
        if not self._open or self._config is None:
            raise DriverError("the driver is not open: open it before use")
        for unit in self._units:
            unit.aim({"preload": in_force.preload, "belt_speed": in_force.belt_speed})
        if self._fault:
            raise DriverError(self._fault)
        with self._lock:
            return self._ready.popleft() if self._ready else None

    def make_safe(self) -> None:
        """Command the safe state on connections kept for it; the units' threads repeat it until `reset`.

        Raises:
            DriverError: a unit did not accept it within `safe_timeout` for each write; the others are commanded.
        """
        self._stops += 1
        self._safe = True
        for unit in list(self._units):
            unit.hold_safe()
        self._command()

    def _command(self) -> None:
        """The safe command, on the connections kept for it or, where there are none now, on new ones."""
        if self._safe_lines:
            _command_all(dict(self._safe_lines))
        elif self._rig is not None:
            self.make_safe_from_outside(self._rig)
        else:
            raise DriverError("the driver was never told its settings: nothing can be commanded")

    # --- begin and end

    def _begin(self, stops: int) -> None:
        """Connect everything; the safe command holds where one has come since there were so many of them."""
        assert self._config is not None
        assert self._rig is not None
        config, rig = self._config, self._rig
        self._ended = threading.Event()
        self._ready.clear()
        self._fault, self._warnings, self._forgotten, self._safe = "", [], 0, self._stops != stops
        rates = {"preload": rig.preload_slew_rate, "belt_speed": rig.belt_acceleration}
        try:
            for name, unit in config.units.items():
                line = self._safe_lines[name] = SafeLine(name, unit, config.acquisition.safe_timeout)
                line.connect()
                places = [place_of(source.register) for source in config.measured.values()]
                self._units.append(
                    UnitThread(
                        name,
                        unit,
                        {key: place for key, place in config.set_points.items() if place.unit == name},
                        frozenset(place.register for place in places if place.unit == name),
                        rates,
                        config.acquisition.write_interval,
                    )
                )
                self._units[-1].start()
            wanted = {name: source.signal for name, source in config.signals.items()}
            self._streams = Streams(config.acquisition.connection, wanted, rig.sample_rate)
            self._thread = threading.Thread(
                target=self._run, args=(self._ended, self._streams), name="acquisition", daemon=True
            )
            self._thread.start()
            self._wait_for_samples()
            if self._stops != stops:
                self.make_safe()
        except BaseException:
            self._end()
            raise

    def _wait_for_samples(self) -> None:
        deadline = time.monotonic() + _FIRST
        while not self._ready:
            if self._fault:
                raise DriverError(self._fault)
            if time.monotonic() > deadline:
                raise DriverError(f"no whole block of samples came within {_FIRST:g} s after connecting")
            time.sleep(_POLL)
        with self._lock:
            self._ready.clear()  # taken before anybody asked

    def _end(self) -> None:
        self._ended.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(5.0)
        for unit in self._units:
            unit.stop()
        self._units = []
        for line in self._safe_lines.values():
            line.close()
        self._safe_lines = {}
        streams, self._streams = self._streams, None
        # Under a thread that still reads them they must not go: openDAQ ends the process then. It lets go itself.
        if streams is not None and (thread is None or not thread.is_alive()):
            streams.close()
        with self._lock:
            self._ready.clear()

    # --- the thread of acquisition

    def _run(self, ended: threading.Event, streams: Streams) -> None:
        try:
            self._acquire(ended, streams)
        except Exception as error:
            sentence = str(error) if isinstance(error, SquealRigError) else f"{type(error).__name__}: {error}"
            if not ended.is_set():
                self._fail(sentence)
        finally:
            if self._streams is not streams:  # nobody waited for us
                streams.close()

    def _acquire(self, ended: threading.Event, streams: Streams) -> None:
        config, rig = self._config, self._rig
        assert config is not None
        assert rig is not None
        delays = {name: source.delay for name, source in config.signals.items()}
        aligner = Aligner(delays, rig.sample_rate, rig.block_size)
        silent = dict.fromkeys(delays, 0.0)
        heard: set[str] = set()
        last = time.monotonic()
        while not ended.is_set():
            now = time.monotonic()
            for name in heard:
                silent[name] += min(now - last, _ROUND)
            last = now
            for packet in streams.packets():
                self._warn(aligner.add(packet.name, packet.time, packet.values, now))
                silent[packet.name] = 0.0
                heard.add(packet.name)
            self.faults = aligner.faults
            while (found := aligner.take_block()) is not None:
                self._put(config, rig, aligner.time_of(found[0]), found[1], found[2])
            quiet = max(silent, key=lambda name: silent[name])
            if silent[quiet] > config.acquisition.stale_after:
                device, age = config.acquisition.connection, silent[quiet]
                raise DriverError(f"signal {quiet} is stale: no samples from {device} for {age:.2f} s")
            for unit in self._units:
                sentence = unit.fault(config.acquisition.stale_after)
                if sentence:
                    raise DriverError(sentence)
            ended.wait(_POLL)

    def _put(
        self, config: HardwareSettings, rig: RigSettings, begin: Fraction, lost: int, values: dict[str, Values]
    ) -> None:
        """Make a reading of aligned samples: scaled, with what the units measure held over it."""
        daq = config.empty_block(rig.block_size)
        for name, source in config.signals.items():
            daq[name] = _scaled(source, values[name])
        for name, source in config.measured.items():
            place = place_of(source.register)
            value = self._value(place.unit, place.register)
            if value is None:  # nothing has been read yet: no block either
                self._forgotten += lost + rig.block_size if self._ready else 0
                return
            daq[name] = source.sign * source.scale * value + source.offset
        stamp = int(begin * _NS)
        if not 0 <= stamp < _LATEST:
            raise DriverError(f"the device's time is {float(begin):g} s since 1970: no stamp holds that, set its clock")
        apart = stamp * 1e-9 - time.time()
        if abs(apart) > config.acquisition.clock_tolerance:
            by = f"{abs(apart):.3g} s" if abs(apart) < _FAR_APART else "years"
            self._warn(f"the device's clock is {by} {'ahead of' if apart > 0 else 'behind'} this machine's", once=True)
        with self._lock:
            reading = Reading(daq, None, tuple(self._warnings), stamp=stamp, lost=lost + self._forgotten)
            self._warnings, self._forgotten = [], 0
            self._ready.append(reading)
            while len(self._ready) > config.acquisition.queue * BLOCKS_PER_SECOND:
                oldest = self._ready.popleft()
                behind = self._ready[0]
                self._ready[0] = Reading(
                    behind.daq,
                    None,
                    (*(w for w in behind.warnings if w != _TOO_SLOW), _TOO_SLOW),
                    stamp=behind.stamp,
                    lost=behind.lost + oldest.lost + len(oldest.daq),
                )

    def _value(self, unit_name: str, register: str) -> float | None:
        assert self._config is not None
        for name, unit in zip(self._config.units, self._units, strict=False):
            if name == unit_name:
                return unit.values.get(register)
        return None

    def _warn(self, sentence: str, once: bool = False) -> None:
        if sentence and len(self._warnings) < _MOST_WARNINGS and not (once and sentence in self._warnings):
            self._warnings.append(sentence)

    def _fail(self, sentence: str) -> None:
        """Stop what can be stopped: who does not see the rig must not move it."""
        self._safe = True
        for unit in self._units:
            unit.hold_safe()
        try:
            _command_all(dict(self._safe_lines))
            done = "every Modbus unit with a safe command has accepted it" if self._safe_lines else ""
        except DriverError as error:
            done = f"the safe command was not accepted: {error}"
        self._fault = f"{sentence}; {done}" if done else sentence


def _scaled(source: ChannelSource, values: Values) -> Values:
    result: Values = source.sign * source.scale * values + source.offset
    return result


def _command_all(lines: dict[str, SafeLine]) -> None:
    """Command every unit at the same time; DriverError naming those that did not accept."""
    errors: dict[str, str] = {}

    def command(name: str, line: SafeLine) -> None:
        try:
            line.command()
        except Exception as error:
            errors[name] = str(error)

    threads = [threading.Thread(target=command, args=item, daemon=True) for item in lines.items()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise DriverError("; ".join(errors.values()))
