"""Where a campaign's results are kept: a Parquet file a chunk, and a journal that says which of them are whole.

A chunk counts once its line stands in the journal; its files were on the disk before. What a killed campaign was at is
measured again from its start, what it had finished never.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import time
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from squeal_rig.configuration.files import only_regular
from squeal_rig.configuration.new_files import new_file
from squeal_rig.errors import DiskError, ExperimentError
from squeal_rig.experiments.campaign.measuring import Table
from squeal_rig.experiments.campaign.plans import Campaign, load_campaign

PLAN, JOURNAL = "plan.yaml", "journal.jsonl"
TABLES = ("points", "events", "steps")
_FILE = re.compile(rf"({'|'.join(TABLES)})/part-\d{{8,}}\.parquet")
_LATEST = 1e11  # time of a line [s since the epoch]
_MOST_BYTES = 1 << 28  # of a journal
NO_EXTRA = "campaigns need more: pip install 'squeal_rig[campaign]'"


class Store:
    """The folder of a campaign.

    Raises:
        DiskError: the folder cannot be written.
        ExperimentError: it holds no campaign, another one, or one that runs already.
    """

    def __init__(self, folder: Path, campaign: Campaign, chunk: int, journal: IO[str]) -> None:
        self.folder, self.campaign, self.chunk, self._journal = folder, campaign, chunk, journal
        self.entries = list(_lines(folder / JOURNAL))
        self.done: dict[int, Mapping[str, Any]] = {
            int(entry["chunk"]): entry for entry in self.entries if entry.get("what") == "chunk"
        }

    @classmethod
    def create(cls, folder: Path, campaign: Campaign, chunk: int, facts: Mapping[str, Any]) -> Store:
        """A new campaign in a folder that is empty or not there."""
        _arrow()
        _check_empty(folder, campaign)
        journal = _locked(folder / JOURNAL)
        try:
            _check_empty(folder, campaign)  # nobody else can begin here from now on
            with new_file(folder / PLAN, force=True) as draft:
                draft.write_bytes(campaign.text.encode())
                _to_disk(draft)
            store = cls(folder, campaign, chunk, journal)
        except BaseException:
            journal.close()
            raise
        store.note("campaign", plan=campaign.crc, chunk_size=chunk, points=campaign.design.count, **facts)
        return store

    @classmethod
    def resume(cls, folder: Path) -> Store:
        """The campaign in a folder, to go on with; chunks whose files are not as they were written are done again."""
        _arrow()
        campaign, first = header(folder)
        store = cls(folder, campaign, int(first["chunk_size"]), _locked(folder / JOURNAL))
        for number, entry in list(store.done.items()):
            if not all(_same(folder / name, crc) for name, crc in entry["files"].items()):
                del store.done[number]
        store.note("resumed", done=len(store.done))
        return store

    @property
    def chunks(self) -> int:
        """Chunks in all."""
        return -(-self.campaign.design.count // self.chunk)

    def missing(self) -> Iterator[int]:
        """Numbers of the chunks that are not done."""
        return (number for number in range(self.chunks) if number not in self.done)

    def span(self, number: int) -> tuple[int, int]:
        """First place of a chunk, and the one after its last."""
        return number * self.chunk, min((number + 1) * self.chunk, self.campaign.design.count)

    def add(self, number: int, tables: Mapping[str, Table], **facts: Any) -> None:
        """Keep the tables of a chunk; once this returns they are safe."""
        pa, pq = _arrow()
        files = {}
        for name, table in tables.items():
            if not table:
                continue
            path = self.folder / name / f"part-{number:08d}.parquet"
            columns = {
                key: pa.array(values.tolist() if values.dtype.kind in "UO" else values) for key, values in table.items()
            }
            with new_file(path, force=True) as draft:
                pq.write_table(pa.table(columns), draft)
                _to_disk(draft)
            files[f"{name}/{path.name}"] = _crc(path)
        entry = {"chunk": number, "rows": len(tables["points"]["place"]), "files": files, **facts}
        self.done[number] = self.note("chunk", **entry)

    def note(self, what: str, **facts: Any) -> dict[str, Any]:
        """Write a line into the journal, and onto the disk."""
        entry = {"what": what, "time": round(time.time(), 3), **facts}
        try:
            self._journal.write(json.dumps(entry) + "\n")
            self._journal.flush()
            os.fsync(self._journal.fileno())
        except OSError as error:
            raise DiskError(f"Cannot write {self.folder / JOURNAL}: {error.strerror}.") from None
        self.entries.append(entry)
        return entry

    def close(self) -> None:
        """Let somebody else go on."""
        self._journal.close()


def header(folder: Path) -> tuple[Campaign, Mapping[str, Any]]:
    """The campaign of a folder, and the first line of its journal.

    Raises:
        ExperimentError: there is none, or its plan was changed since.
    """
    first = next(iter(_lines(folder / JOURNAL)), None)
    if first is None or not (folder / PLAN).is_file():
        raise ExperimentError(f"{folder} holds no campaign: it has no {PLAN} and {JOURNAL}")
    campaign = load_campaign(folder / PLAN)
    if campaign.crc != first.get("plan"):
        raise ExperimentError(f"{folder / PLAN} is not the plan that was begun here: results of two plans do not mix")
    return campaign, first


def journal(folder: Path) -> list[dict[str, Any]]:
    """Lines of the journal of a campaign."""
    return list(_lines(folder / JOURNAL))


def read(folder: Path, name: str, columns: list[str] | None = None) -> Table:
    """One of the `TABLES` of a campaign, what is whole of it, in the order of the plan; empty where there is none."""
    pa, pq = _arrow()
    done = {int(entry["chunk"]): entry for entry in _lines(folder / JOURNAL) if entry.get("what") == "chunk"}
    files = [folder / file for number in sorted(done) for file in done[number]["files"] if file.startswith(f"{name}/")]
    if not files:
        return {}
    try:
        tables = [pq.read_table(file, columns=columns) for file in files]
        table = pa.concat_tables(tables, promote_options="permissive")
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())[:200]
        raise ExperimentError(
            f"{folder}: the table {name!r} cannot be read: {reason};"
            f" `squeal-rig campaign resume {folder}` measures again what is damaged"
        ) from None
    return {
        key: np.asarray(
            table.column(key).to_pylist()
            if pa.types.is_string(table.schema.field(key).type)
            else table.column(key).to_numpy()
        )
        for key in table.column_names
    }


def _check_empty(folder: Path, campaign: Campaign) -> None:
    """DiskError where a folder holds anything but what this campaign left as it was killed before its first line."""
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".")} if folder.is_dir() else set()
    if PLAN in names and _read(folder / PLAN) == campaign.text.encode():
        names.discard(PLAN)
    begins, line = b'{"what": "campaign"', b""
    if JOURNAL in names:
        line = _read(folder / JOURNAL)
        if b"\n" not in line and begins.startswith(line[: len(begins)]):
            names.discard(JOURNAL)
    if names and line.startswith(begins):
        raise DiskError(f"{folder} holds a campaign: `squeal-rig campaign resume {folder}` goes on with it.")
    if names:
        raise DiskError(f"{folder} is not empty, and holds no campaign: choose another folder.")


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise ExperimentError(NO_EXTRA) from None
    return pa, pq


def _locked(path: Path) -> IO[str]:
    """The journal, open to go on writing; a line that was cut is cut off."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = path.open("a+", encoding="utf-8")
    except OSError as error:
        raise DiskError(f"Cannot write {path}: {error.strerror}.") from None
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        stream.close()
        raise ExperimentError(f"the campaign in {path.parent} runs already") from None
    data = _read(path)
    os.truncate(path, data.rfind(b"\n") + 1)
    stream.seek(0, os.SEEK_END)
    return stream


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    try:
        data = _read(path)
    except OSError:
        return
    for line in data.split(b"\n")[:-1]:
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(entry, dict) and isinstance(entry.get("what"), str) and _is_sound(entry):
            yield entry


# What a line of each kind must hold, to be one of ours.
_HOLDS: dict[str, dict[str, type]] = {
    "chunk": {"chunk": int, "rows": int, "failed": int, "files": dict},
    "campaign": {"plan": str, "chunk_size": int, "points": int},
    "run ended": {"outcome": str},
}


def _is_sound(entry: dict[str, Any]) -> bool:
    """Whether a line is one of ours: its values are used, and files that it names are read."""
    held: dict[str, Any] = {"time": (int, float), **_HOLDS.get(entry["what"], {})}
    given = {"failed": 0, **entry}
    if not all(isinstance(given.get(name), kind) for name, kind in held.items()) or not 0 < entry["time"] < _LATEST:
        return False
    if entry["what"] == "campaign":
        return bool(entry["chunk_size"] > 0)
    return entry["what"] != "chunk" or all(_FILE.fullmatch(name) for name in entry["files"])


def _read(path: Path) -> bytes:
    """Content of a file; OSError where it is none, or longer than any journal."""
    with open(path, "rb", opener=only_regular) as stream:
        data = stream.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise OSError(errno.EFBIG, f"More than {_MOST_BYTES} bytes", str(path))
    return data


def _to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _crc(path: Path) -> int:
    return zlib.crc32(path.read_bytes())


def _same(path: Path, crc: int) -> bool:
    return path.is_file() and _crc(path) == crc
