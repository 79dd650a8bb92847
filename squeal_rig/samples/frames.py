"""Readers for notebooks: samples of a bag as a numpy array, an Arrow table or a pandas frame.

from squeal_rig.samples.frames import read_frame
frame = read_frame("bags/run", "daq/samples", columns=["x", "y"], start=5.0, end=6.0)
frame.attrs["units"]["x"]     # 'm'
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag
from squeal_rig.samples.columns import SampleColumns

_DEFAULT = "daq/samples"


def read_array(
    bag: str | Path,
    topic: str = _DEFAULT,
    columns: Sequence[str] = (),
    start: float | None = None,
    end: float | None = None,
) -> NDArray[np.void]:
    """Samples as a structured array (n,); start and end in [s] after the bag's first message.

    Raises:
        RecordingError: no such bag, topic or column, or a damaged message.
    """
    samples = SampleColumns(Bag(bag), topic, columns, start, end)
    whole = samples.whole()
    count = len(next(iter(whole.values())))
    array = np.empty(count, [(info.name, info.dtype) for info in samples.infos])
    for name, values in whole.items():
        array[name] = values
    return array


def read_table(
    bag: str | Path,
    topic: str = _DEFAULT,
    columns: Sequence[str] = (),
    start: float | None = None,
    end: float | None = None,
) -> Any:
    """Samples as a pyarrow.Table, unit and description in each field's metadata. Errors as in `read_array`."""
    pa = needed("pyarrow")
    samples = SampleColumns(Bag(bag), topic, columns, start, end)
    return pa.table(samples.whole(), schema=arrow_schema(samples))


def read_frame(
    bag: str | Path,
    topic: str = _DEFAULT,
    columns: Sequence[str] = (),
    start: float | None = None,
    end: float | None = None,
) -> Any:
    """Samples as a pandas.DataFrame; `frame.attrs["units"]` has the unit of each column. Errors as in `read_array`."""
    pd = needed("pandas")
    samples = SampleColumns(Bag(bag), topic, columns, start, end)
    frame = pd.DataFrame(samples.whole(), copy=False)
    frame.attrs["units"] = {info.name: info.unit for info in samples.infos}
    return frame


def arrow_schema(samples: SampleColumns) -> Any:
    """The pyarrow.Schema of a topic's columns."""
    pa = needed("pyarrow")
    fields = [
        pa.field(
            info.name,
            pa.from_numpy_dtype(info.dtype),
            nullable=False,
            metadata={"unit": info.unit, "description": info.description},
        )
        for info in samples.infos
    ]
    return pa.schema(fields)


def needed(package: str) -> Any:
    """An optional package; RecordingError, one sentence, where it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError:
        raise RecordingError(
            f"This needs the Python package {package}, which is not installed: pip install 'squeal_rig[export]'."
        ) from None
