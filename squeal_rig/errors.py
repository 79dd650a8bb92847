"""Errors of squeal_rig. Each message is one sentence: what, the value, the bound, the unit."""

_LONGEST = 1000


def printable(text: str, keep: str = "") -> str:
    """Return a text with every character that could steer a terminal written as its escape, but those in `keep`."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text)


class SquealRigError(Exception):
    """Base of every error that a user can cause; the command line prints its message and exits with code 2.

    A message may name what stands in a file or came over the network: it is printable, and cut where it is long.
    """

    def __str__(self) -> str:
        text = printable(super().__str__()[: _LONGEST + 1])
        return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."


class ParameterError(SquealRigError):
    """A parameter is unknown, of the wrong type, not finite or out of its bounds."""


class ConfigurationError(SquealRigError):
    """A file of ours (parameters, plan, preset) is missing or cannot be read."""


class ModelError(SquealRigError):
    """The model has no answer: no equilibrium in contact, or a trajectory that left every bound."""


class RecordingError(SquealRigError):
    """A bag cannot be written or read."""


class DiskError(RecordingError):
    """The disk refuses what is to be written: it is full, read-only or gone. Everything else can be recorded on."""


class DriverError(SquealRigError):
    """A driver of the rig failed or cannot do what it was asked."""


class ExperimentError(SquealRigError):
    """A plan cannot be run, or a step of it did not reach its condition in time."""


class NoHitError(ExperimentError):
    """No hit starts squeal at this operating point, or none is needed."""


class SafetyError(SquealRigError):
    """The rig is stopped and may not move, or the supervisor cannot release it."""
