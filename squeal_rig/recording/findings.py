"""What is found of a bag that is checked or recovered, and how it is told."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from .gaps import SampleCount

_MAX_FINDINGS = 200
_MAX_NAMED = 5


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong (`error`) or worth knowing (`warning`), and where."""

    level: str
    where: str
    sentence: str


@dataclass
class Verdict:
    """What a bag was found to be; sound when there is no error."""

    path: Path
    findings: list[Finding] = field(default_factory=list)
    messages: int = 0
    bytes: int = 0
    samples: dict[str, SampleCount] = field(default_factory=dict)
    left_out: int = 0

    @property
    def sound(self) -> bool:
        """Whether no error was found."""
        return not any(finding.level == "error" for finding in self.findings)

    def sentences(self) -> list[str]:
        """What to tell the user: the findings, then whether the bag is sound."""
        told = [f"{finding.level}: {finding.where}: {finding.sentence}" for finding in self.findings]
        if self.left_out:
            told.append(f"... and {self.left_out} more")
        samples = sum(count.samples for count in self.samples.values())
        seen = f"{self.messages} messages, {samples} samples, {self.bytes / 1e6:.1f} MB"
        return [*told, f"{'sound' if self.sound else 'NOT sound'}: {seen} checked in {self.path}"]

    def error(self, where: str, sentence: str) -> None:
        """Note something wrong."""
        self._add("error", where, sentence)

    def warn(self, where: str, sentence: str) -> None:
        """Note something worth knowing."""
        self._add("warning", where, sentence)

    def _add(self, level: str, where: str, sentence: str) -> None:
        if len(self.findings) < _MAX_FINDINGS:
            self.findings.append(Finding(level, where, sentence))
        else:
            self.left_out += 1


@dataclass
class Recovery:
    """What came of it.

    messages saved, of them `unproved` without a checksum in the file; chunks saved and damaged; `lost` messages that
    the numbering or the summary shows to be missing; `lost_seconds` [s] between intact pieces with damage in between;
    `closed` whether every file had its ending; `uncounted` files whose summary should say how much they hold and
    cannot be read; `unread_bytes` behind the last intact piece of files without one;
    `files_within` other MCAP files found inside; `missing_files` names of files that the folder lacks, `empty_files` of
    those that are there without a byte; `unended` whether the file is not there in which a recorder of ours says how
    the recording ended.
    """

    messages: int = 0
    unproved: int = 0
    chunks: int = 0
    damaged_chunks: int = 0
    lost: int = 0
    lost_seconds: float = 0.0
    unread_bytes: int = 0
    closed: bool = True
    uncounted: int = 0
    refused: dict[str, int] = field(default_factory=dict)  # reason -> messages
    lost_records: int = 0
    files_within: int = 0
    missing_files: list[str] = field(default_factory=list)
    empty_files: list[str] = field(default_factory=list)
    unended: bool = False

    @property
    def complete(self) -> bool:
        """Whether nothing is known to be lost."""
        left_out = self.refused or self.lost_records or self.files_within or self.missing_files or self.empty_files
        damaged = self.lost or self.uncounted or self.damaged_chunks or self.unread_bytes or self.unended
        return self.closed and not (damaged or left_out)

    def sentences(self) -> list[str]:
        """What to tell the user."""
        told = [f"saved {self.messages} messages in {self.chunks} intact pieces"]
        if self.complete and not self.unproved:
            return [*told, "nothing is missing"]
        if self.lost or self.lost_seconds or self.damaged_chunks:
            told.append(
                f"lost {self.lost} messages and {self.lost_seconds:.3f} s between intact pieces,"
                f" {self.damaged_chunks} chunks damaged"
            )
        if not self.closed:
            told.append(
                "the recording was not closed: what had not reached the file is lost too (at most one second of a"
                f" recorder of ours); {self.unread_bytes} bytes at the end hold nothing intact"
            )
        if self.uncounted:
            told.append(
                f"{self.uncounted} of the files have lost the count of what they should hold: more may be missing"
            )
        if self.unproved:
            told.append(f"{self.unproved} of the messages have no checksum in the file: nothing vouches for them")
        if self.lost_records:
            told.append(f"{self.lost_records} damaged metadata records were left out")
        if self.files_within:
            told.append(f"{self.files_within} MCAP files inside the files (attached, or in a message) were left out")
        if self.empty_files:
            few = ", ".join(self.empty_files[:_MAX_NAMED])
            told.append(f"{len(self.empty_files)} files of the bag are empty ({few}): what was in them is lost")
        if self.missing_files:
            few = ", ".join(self.missing_files[:_MAX_NAMED])
            told.append(f"{len(self.missing_files)} files of the bag are not there ({few}): what was in them is lost")
        elif self.unended:
            told.append("no file says how the recording ended: the last ones are not there, what was in them is lost")
        told += [f"{count} messages were left out: {reason}" for reason, count in self.refused.items()]
        return told
