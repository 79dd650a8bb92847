"""Reading diagnostic statuses."""


def status_of(message, name):
    """(level as an integer, message, values by key) of the status of that name; None where it is not in there."""
    for status in message.status:
        if status.name == name:
            return (
                int.from_bytes(status.level, "little"),
                status.message,
                {pair.key: pair.value for pair in status.values},
            )
    return None


def healths_of(messages, name):
    """Every health of a node among messages of `/diagnostics`, the newest first.

    What is told of one second only is not to be looked for in the newest: two may have come since the last look.
    """
    found = (status_of(message, name) for message in reversed(messages))
    return (health for health in found if health is not None)


def health_of(messages, name):
    """The newest health of a node among messages of `/diagnostics`, or None."""
    return next(healths_of(messages, name), None)
