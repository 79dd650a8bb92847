"""Occurrence of squeal out of the bags of a live campaign, by code that shares nothing with the project's."""

import json
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.signal import welch

# The end of each point that is looked at [s]; what is squeal: RMS of a line [m], and its power over the median line.
_SECONDS, _RMS, _PROMINENCE = 0.3, 1e-6 * 10.0 ** (-12.0 / 20.0), 1e3


def squealing_points(folder: Path) -> dict[int, bool]:
    """Point -> whether it squealed, of every point that a bag in `folder` says was measured to its end."""
    found: dict[int, bool] = {}
    for file in sorted(folder.glob("*/*.mcap")):
        ends, pieces = [], []
        with file.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages(["/daq/samples", "/run/events"]):
                if channel.topic == "/run/events":
                    for status in message.status:
                        values = {pair.key: pair.value for pair in status.values}
                        if status.message == "step ended" and values["outcome"] == "done":
                            ends.append((int(values["point"]), int(values["next sample"])))
                    continue
                offsets = {field.name: (field.offset, field.datatype) for field in message.fields}
                rows = np.frombuffer(bytes(message.data), np.uint8).reshape(-1, message.point_step)
                columns = {}
                for name in ("seq", "t", "x"):
                    offset, datatype = offsets[name]
                    kind = {5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}[datatype]
                    columns[name] = rows[:, offset : offset + np.dtype(kind).itemsize].copy().view(kind)[:, 0]
                pieces.append(columns)
        if not pieces:
            continue
        seq, t, x = (np.concatenate([piece[name] for piece in pieces]).astype(float) for name in ("seq", "t", "x"))
        rate = round(1.0 / np.median(np.diff(t[: len(pieces[0]["t"])])))
        for point, end in ends:
            last = x[(seq >= end - _SECONDS * rate) & (seq < end)]
            frequency, power = welch(last, rate, "hann", nperseg=len(last) // 2, scaling="spectrum")
            band = (frequency >= 500.0) & (frequency <= 5000.0)
            # A line between two lines loses at most 1.42 dB; "spectrum" is the mean square of a line.
            loud = power[band].max() * 1.18 >= _RMS**2
            found[point] = bool(loud and power[band].max() > _PROMINENCE * np.median(power[band]))
    return found


if __name__ == "__main__":
    import sys

    points = squealing_points(Path(sys.argv[1]))
    print(json.dumps(points), sum(points.values()), "of", len(points))  # noqa: T201
