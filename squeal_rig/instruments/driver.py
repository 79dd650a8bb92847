"""The seam between the rig and what stands behind it: a simulation now, hardware later."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import DriverError
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.parameters import RigParameters

Samples = NDArray[np.void]


@dataclass(frozen=True)
class Reading:
    """What a driver reads in one block.

    `daq` has the fields of `DAQ_RECORD`; a driver may append columns. `truth` has those of `TRUTH_RECORD`, or is None
    where nobody knows the truth. `warnings` are sentences about samples whose physics is out of the model's range.
    """

    daq: Samples
    truth: Samples | None
    warnings: tuple[str, ...] = ()


class Driver(Protocol):
    """A rig that can be sampled. Every method may raise `DriverError`."""

    publishes_truth: bool

    def open(self, parameters: RigParameters, settings: RigSettings) -> None:
        """Take the machine's constants and get ready to sample."""

    def close(self) -> None:
        """Let go of the rig."""

    def reset(self) -> None:
        """Bring the pad to rest at the equilibrium of the parameters in force."""

    def impact(self, impulse_x: float, impulse_y: float) -> None:
        """Hit the pad with an impulse [N s] at the next block boundary."""

    def read(self, in_force: RigParameters) -> Reading:
        """The next block, with these parameters in force over all of it. `seq` and `t` are the caller's to fill."""


def make_driver(name: str) -> Driver:
    """The driver of that name."""
    # Imported here: a rig on hardware need not load the compiled model, nor a virtual one the hardware's library.
    if name == "virtual":
        from squeal_rig.instruments.virtual import VirtualRig

        driver: Driver = VirtualRig()
        return driver
    raise DriverError(f"driver = {name!r} is not known")
