"""Driver `faulty`: the virtual rig with faults, each a file in the folder FAULTS; its content says how much.

Copied into an installed package of its own, as a lab's driver would be.
"""

import contextlib
import ctypes
import dataclasses
import os
import time
from pathlib import Path

from squeal_rig.instruments.virtual import VirtualRig

FOLDER = Path(os.environ["FAULTS"])
_BLOCK_NS = 10_000_000
# Two blocks swapped: lost samples (negative is back) and steps of the time, in blocks, of three readings.
_SWAP = ((1, 1), (-2, -1), (1, 0))


class FaultyRig(VirtualRig):
    """Keeps the device's time, so that it can be wrong."""

    def __init__(self):
        super().__init__()
        self._stamp = None
        self._held, self._swaps, self._grown = {}, [], 0.0

    def open(self, parameters, settings):
        self._stamp = None  # what `open` reads is thrown away
        super().open(parameters, settings)
        self._stamp = None
        if "cannot open" in self._faults():
            raise ZeroDivisionError("no bridge voltage in open")

    def _faults(self):
        found = {}
        for name in os.listdir(FOLDER):
            if not name.startswith("done"):
                with contextlib.suppress(FileNotFoundError):  # taken back just now
                    found[name] = (FOLDER / name).read_text()
        return found

    def read(self, in_force):
        faults = self._faults()
        if "raise" in faults:
            raise ZeroDivisionError("no bridge voltage")
        if "no blocks" in faults:
            return None
        while "hang" in faults:  # the GIL is released
            time.sleep(0.01)
            faults = self._faults()
        if "hold" in faults:
            ctypes.PyDLL(None).usleep(int(1e6 * float(faults["hold"])))
        if "slow" in faults:
            time.sleep(float(faults["slow"]))
        reading = super().read(in_force)
        daq = reading.daq
        self._stamp = time.time_ns() if self._stamp is None else self._stamp + _BLOCK_NS
        stamp, lost = self._stamp, 0
        if "jump" in faults:
            self._stamp += int(1e9 * float(self._once("jump")))
            stamp = self._stamp
        if "lose" in faults:
            lost = int(self._once("lose")) * len(daq)
            self._stamp += lost * _BLOCK_NS // len(daq)
            stamp = self._stamp
        if "lose half" in faults:
            lost = len(daq)
            self._stamp += _BLOCK_NS
            stamp = self._stamp
        if "jump the numbers" in faults:
            lost = int(self._once("jump the numbers"))
        if "swap" in faults:
            self._swaps += list(_SWAP) * int(self._once("swap"))
        if self._swaps:
            blocks, steps = self._swaps.pop(0)
            lost, stamp = blocks * len(daq), stamp + steps * _BLOCK_NS
        for name in ("stuck", "nan", "set", "add", "spike", "stall", "runaway"):
            if name not in faults:
                self._held.pop(name, None)
                continue
            channel, _, value = faults[name].partition(" ")
            if name == "stuck":
                self._held.setdefault(name, float(daq[channel][-1]))
                daq[channel] = self._held[name]
            elif name in ("nan", "set"):
                daq[channel] = float(value)
            elif name == "add":
                daq[channel] += float(value)
            elif name == "spike":
                daq[channel][len(daq) // 2] = float(value)
                self._once("spike")
            elif name == "stall":
                daq["belt_speed"] = 0.0
            elif name == "runaway":  # 5 m/s^2 beyond every set point
                self._grown = self._held.get(name, 0.0) + 0.05
                self._held[name] = self._grown
                daq["belt_speed"] += self._grown
        return dataclasses.replace(reading, stamp=stamp, lost=lost)

    def _once(self, name):
        """A fault that happens once; its content."""
        text = (FOLDER / name).read_text()
        (FOLDER / name).unlink()
        return text

    def make_safe(self):
        faults = self._faults()
        if "refuse safe" in faults:
            raise OSError("the inverter does not answer")
        while "hang safe" in faults:
            time.sleep(0.01)
            faults = self._faults()
        super().make_safe()

    @classmethod
    def make_safe_from_outside(cls, settings):
        (FOLDER / "done from outside").write_text(f"{time.time_ns()} {settings.sample_rate}")
