"""`metadata.yaml` of a bag directory, version 9, as rosbag2 Jazzy writes it (rosbag2_storage/yaml.hpp)."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from squeal_rig.configuration.files import MAX_FOREIGN_YAML, dump_yaml, parse_yaml_texts, read_text
from squeal_rig.configuration.new_files import new_file
from squeal_rig.errors import ConfigurationError, RecordingError

from .qos_yaml import QosProfile, qos_from_list, qos_from_yaml, qos_to_mapping

METADATA_FILE = "metadata.yaml"
_VERSION = 9
_ROOT = "rosbag2_bagfile_information"


@dataclass(frozen=True)
class TopicEntry:
    """One topic of a bag."""

    name: str
    type_name: str
    message_count: int = 0
    qos: tuple[QosProfile, ...] = ()
    type_hash: str = ""
    serialization_format: str = "cdr"


@dataclass(frozen=True)
class FileEntry:
    """One file of a bag; times are log times [ns], 0 where it holds no message."""

    path: str
    start_time: int
    end_time: int
    message_count: int


@dataclass(frozen=True)
class BagMetadata:
    """What `metadata.yaml` says about a bag."""

    files: tuple[FileEntry, ...]
    topics: tuple[TopicEntry, ...]
    custom_data: Mapping[str, str]
    ros_distro: str = "jazzy"

    @property
    def message_count(self) -> int:
        """Messages in all files."""
        return sum(file.message_count for file in self.files)

    @property
    def start_time(self) -> int:
        """First log time [ns]; 0 for a bag without messages."""
        return min((file.start_time for file in self.files if file.message_count), default=0)

    @property
    def end_time(self) -> int:
        """Last log time [ns]; 0 for a bag without messages."""
        return max((file.end_time for file in self.files if file.message_count), default=0)


def metadata_mapping(metadata: BagMetadata) -> dict[str, Any]:
    """Return rosbag2's mapping, keys in rosbag2's order, without the root key."""
    topics = [
        {
            "topic_metadata": {
                "name": topic.name,
                "type": topic.type_name,
                "serialization_format": topic.serialization_format,
                "offered_qos_profiles": [qos_to_mapping(qos) for qos in topic.qos],
                "type_description_hash": topic.type_hash,
            },
            "message_count": topic.message_count,
        }
        for topic in metadata.topics
    ]
    files = [
        {
            "path": file.path,
            "starting_time": {"nanoseconds_since_epoch": file.start_time},
            "duration": {"nanoseconds": file.end_time - file.start_time},
            "message_count": file.message_count,
        }
        for file in metadata.files
    ]
    return {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": metadata.end_time - metadata.start_time},
        "starting_time": {"nanoseconds_since_epoch": metadata.start_time},
        "message_count": metadata.message_count,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.path for file in metadata.files],
        "files": files,
        "custom_data": dict(metadata.custom_data) or None,
        "ros_distro": metadata.ros_distro,
    }


def metadata_yaml(metadata: BagMetadata) -> str:
    """Return the mapping as YAML: what rosbag2 keeps as `serialized_metadata` inside each file."""
    return dump_yaml(metadata_mapping(metadata))


def write_metadata(directory: Path, metadata: BagMetadata) -> None:
    """Write `metadata.yaml` in one step: it is there whole or not at all."""
    with new_file(directory / METADATA_FILE, force=True) as draft, open(draft, "w", encoding="utf-8") as stream:
        stream.write(dump_yaml({_ROOT: metadata_mapping(metadata)}))
        stream.flush()
        os.fsync(stream.fileno())


def read_metadata(directory: Path) -> BagMetadata | None:
    """Return what `metadata.yaml` says (versions 1 to 9), or None where there is none.

    Raises RecordingError when it cannot be read or describes another storage than MCAP.
    """
    path = directory / METADATA_FILE
    if not path.exists():
        return None
    try:
        return _from_mapping(parse_yaml_texts(read_text(path, MAX_FOREIGN_YAML), METADATA_FILE)[_ROOT])
    except (ConfigurationError, RecordingError) as error:
        raise RecordingError(f"{path} is no metadata of a bag that can be read: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordingError(f"{path} is no metadata of a bag ({type(error).__name__}: {error}).") from None


def _from_mapping(mapping: Mapping[str, Any]) -> BagMetadata:
    storage = mapping["storage_identifier"]
    if storage != "mcap":
        raise RecordingError(f"the bag is stored as {storage!r}; only 'mcap' can be read.")
    if mapping.get("compression_mode") or mapping.get("compression_format"):
        raise RecordingError("the bag's files or messages are compressed one by one; decompress them first.")
    start = int(mapping["starting_time"]["nanoseconds_since_epoch"])
    paths = [str(path) for path in mapping["relative_file_paths"]]
    default = [{"path": path, "message_count": 0} for path in paths]
    files = [_file_entry(entry, start) for entry in mapping.get("files") or default]
    topics = [
        _topic_entry(entry["topic_metadata"], int(entry["message_count"]))
        for entry in mapping["topics_with_message_count"]
    ]
    return BagMetadata(
        files=tuple(files),
        topics=tuple(topics),
        custom_data=_custom_data(mapping),
        ros_distro=str(mapping.get("ros_distro", "")),
    )


def _file_entry(entry: Mapping[str, Any], bag_start: int) -> FileEntry:
    start = int(entry.get("starting_time", {}).get("nanoseconds_since_epoch", bag_start))
    end = start + int(entry.get("duration", {}).get("nanoseconds", 0))
    return FileEntry(str(entry["path"]), start, end, int(entry["message_count"]))


def _topic_entry(entry: Mapping[str, Any], message_count: int) -> TopicEntry:
    offered = entry.get("offered_qos_profiles")
    return TopicEntry(
        name=str(entry["name"]),
        type_name=str(entry["type"]),
        message_count=message_count,
        qos=qos_from_yaml(offered) if isinstance(offered, str) else qos_from_list(offered),
        type_hash=str(entry.get("type_description_hash", "")),
        serialization_format=str(entry["serialization_format"]),
    )


def paths_of(files: Sequence[FileEntry], directory: Path) -> tuple[Path, ...]:
    """Return where the files of a bag are; very old bags name them with the directory, which is dropped."""
    return tuple(directory / Path(file.path).name for file in files)


def custom_data_of(serialized_metadata: str) -> dict[str, str]:
    """Return the custom data of rosbag2's `serialized_metadata` text; empty where it cannot be read."""
    try:
        loaded = parse_yaml_texts(serialized_metadata, "serialized_metadata")
    except ConfigurationError:
        return {}
    return _custom_data(loaded) if isinstance(loaded, Mapping) else {}


def _custom_data(mapping: Mapping[str, Any]) -> dict[str, str]:
    custom = mapping.get("custom_data")
    return {str(key): str(value) for key, value in custom.items()} if isinstance(custom, Mapping) else {}
