"""The seam between the rig and what stands behind it: a simulation now, hardware later."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import DriverError
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.parameters import RigParameters

Samples = NDArray[np.void]

#: Group of entry points: a package that brings a driver names its class there.
DRIVERS = "squeal_rig.drivers"


@dataclass(frozen=True)
class Capabilities:
    """What a driver can do, told before it is opened.

    Args:
        set_points: rig parameters that it can move while it samples; a change of any other is refused meanwhile.
        knows_truth: whether it reads the truth, which no hardware does.
        can_hit: whether it can give the pad an impact.
        keeps_time: whether its blocks carry the device's own time, and it can be late; else the rig counts.
        not_measured: channels of `daq` that nobody measures on this rig, the clips of one without them for instance:
            they carry a fixed value.
    """

    set_points: frozenset[str]
    knows_truth: bool
    can_hit: bool
    keeps_time: bool = False
    not_measured: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Reading:
    """What a driver reads in one block.

    `daq` has the fields of `DAQ_RECORD`; a driver may append columns. `truth` has those of `TRUTH_RECORD`, or is None
    where nobody knows the truth. `warnings` are sentences about samples that are not to be believed as they are: the
    physics out of the model's range, a time of the device that cannot be. `stamp` is the device's time of the first
    sample [ns], None where the rig counts; `lost` is how many samples the device lost since the block before.
    """

    daq: Samples
    truth: Samples | None
    warnings: tuple[str, ...] = ()
    stamp: int | None = None
    lost: int = 0


class Driver(Protocol):
    """A rig that can be sampled. Every method may raise `DriverError`.

    All but `make_safe` are called from one thread.
    """

    def capabilities(self, settings: RigSettings) -> Capabilities:
        """What it can do with these settings; asked before it is opened."""

    def open(self, parameters: RigParameters, settings: RigSettings) -> None:
        """Take the machine's constants and get ready to sample."""

    def close(self) -> None:
        """Let go of the rig."""

    def reset(self) -> None:
        """Bring the pad to rest at the equilibrium of the parameters in force; it may move again after `make_safe`."""

    def impact(self, impulse_x: float, impulse_y: float) -> None:
        """Give the pad an impulse [N s] at the next block boundary."""

    def read(self, in_force: RigParameters) -> Reading | None:
        """The next block, with these parameters commanded over all of it; `seq` and `t` are the caller's to fill.

        None where the device has no whole block yet: it is asked again, and nothing waits meanwhile.
        """

    def make_safe(self) -> None:
        """Command no preload and a belt at rest, and return once that is accepted.

        Called from any thread at any time, while `read` hangs too. Until `reset` what `read` is given is not commanded.
        """


def driver_class(name: str) -> type[Driver]:
    """The class that an installed package offers under that name; only its own module is loaded.

    Raises:
        DriverError: nobody or more than one offers it, or it cannot be loaded.
    """
    offered = entry_points(group=DRIVERS)
    chosen = {entry.value: entry for entry in offered if entry.name == name}
    if not chosen:
        raise DriverError(f"driver = {name!r} is not known: there are {', '.join(sorted(offered.names)) or 'none'}")
    if len(chosen) > 1:
        raise DriverError(f"driver = {name!r} is offered more than once: by {' and '.join(sorted(chosen))}")
    (entry,) = chosen.values()
    try:
        loaded: type[Driver] = entry.load()
    except (Exception, SystemExit) as error:  # whatever a foreign module does when it is imported
        raise DriverError(
            f"driver = {name!r} cannot be loaded from {entry.value}: {type(error).__name__}: {error}"
        ) from None
    return loaded
