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


def health_of(messages, name):
    """The newest health of a node among messages of `/diagnostics`, or None."""
    for message in reversed(messages):
        found = status_of(message, name)
        if found is not None:
            return found
    return None
