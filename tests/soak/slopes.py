"""Whether a series grows: what of memory and handles is judged by."""

import numpy as np

# What a node takes up in its first time is no leak: caches, queues, the first of everything. A share of a life, and a
# time [s]: on a machine that is too slow for it all, each kill of another node can be the longest queue so far.
_WARM_UP, _FIRST = 0.25, 300.0
_POINTS, _FINE = 200, 15.0  # of a life, and at most so long [s] each
_SHORT = 60.0, 90.0  # between two points [s]: a file of the recorder and more, much less than from one kill to the next
#: Growth over a life that is none yet: [MB] of memory, handles.
TOLERATED = {"memory": 8.0, "handles": 6.0}


def growth(times, values, distance=(0.0, np.inf)):
    """Growth over the observed time, by the median of all slopes (Theil, Sen), after its first quarter or 300 s.

    Medians, since a splitting recorder or a map that is computed makes single high values. `distance` bounds the time
    between the two points of a slope [s].
    """
    times, values = np.asarray(times, float), np.asarray(values, float)
    late = times >= times[0] + max(_FIRST, _WARM_UP * (times[-1] - times[0]))
    times, values = times[late], values[late]
    if len(times) < 10:
        return 0.0
    points = max(_POINTS, int(np.ceil((times[-1] - times[0]) / _FINE)))
    groups = np.array_split(np.arange(len(times)), min(points, len(times)))
    t = np.array([times[group].mean() for group in groups])
    v = np.array([np.median(values[group]) for group in groups])
    later, earlier = np.triu_indices(len(t), 1)[::-1]
    apart = t[later] - t[earlier]
    counted = (apart >= distance[0]) & (apart <= distance[1])
    if not counted.any():
        return 0.0
    return float(np.median((v[later] - v[earlier])[counted] / apart[counted]) * (t[-1] - t[0]))


def faults_of(name, kind, times, values, queues=0.0):
    """A sentence where a series of one life grows by more than is tolerated, else nothing.

    A queue keeps the room that it has once needed, so memory rises by steps whenever its node is further behind than
    before, by what its `queues` hold [MB] at most. What rises between the steps is judged without that.
    """
    within = f"within {times[-1] - times[0]:.0f} s of one life"
    unit = " MB" if kind == "memory" else ""
    if (grown := growth(times, values)) > TOLERATED[kind] + queues:
        return [f"{name}: {kind} grew by {grown:.1f}{unit} {within}"]
    if (grown := growth(times, values, _SHORT)) > TOLERATED[kind]:
        return [f"{name}: {kind} grew all the time, by {grown:.1f}{unit} {within}"]
    return []
