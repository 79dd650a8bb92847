"""One self-contained HTML page of sections with text, tables and pictures."""

from __future__ import annotations

import csv
import html
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from squeal_rig.configuration.files import reason_of
from squeal_rig.configuration.new_files import new_file
from squeal_rig.errors import DiskError
from squeal_rig.report.paper_style import Picture

_STYLE = """
body { font: 16px/1.5 Georgia, serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #111; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2.5rem; border-bottom: 1px solid #999; }
table { border-collapse: collapse; margin: 1rem 0; font: 14px/1.35 Helvetica, Arial, sans-serif; }
th, td { border: 1px solid #bbb; padding: .25rem .6rem; text-align: right; vertical-align: top; }
th { background: #eee; } td.text, th.text { text-align: left; }
td.agrees { font-weight: bold; } td.differs { background: #e4e4e4; font-style: italic; }
figure { margin: 1.5rem 0; } img { max-width: 100%; } figcaption { font-size: 14px; color: #333; }
"""


@dataclass(frozen=True)
class DataTable:
    """A table: file stem, caption, column names with units, rows; `heads` stand on the page in place of the names.

    The CSV has all digits.
    """

    name: str
    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    heads: Sequence[str] | None = None

    def write_csv(self, path: Path) -> None:
        """Write the table with all digits."""
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(self.columns)
            writer.writerows(self.rows)


@dataclass
class Section:
    """A heading, its text (plain, one paragraph an entry), tables and pictures; `data`: tables for files only."""

    title: str
    text: list[str] = field(default_factory=list)
    tables: list[DataTable] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    data: list[DataTable] = field(default_factory=list)


def check_folder(folder: Path, force: bool = False) -> None:
    """Raise DiskError where a folder has something in it and is not to be written into."""
    try:
        taken = any(folder.iterdir()) if folder.is_dir() else os.path.lexists(folder)
    except OSError as error:
        raise DiskError(f"Cannot write into {folder}: {reason_of(error)}.") from None
    if taken and not folder.is_dir():
        raise DiskError(f"{folder} exists already, and is no folder.")
    if taken and not force:
        raise DiskError(f"{folder} is not empty; --force overwrites what has the names of the new files.")


def write_report(title: str, lead: Sequence[str], sections: Sequence[Section], page: Path, force: bool = False) -> None:
    """Write the page, and beside it every picture as PNG and every table as CSV.

    Raises:
        DiskError: a file is there already and not to be overwritten, or the system refuses.
    """
    for section in sections:
        for shown in section.pictures:
            with new_file(page.parent / f"{shown.name}.png", force) as draft:
                draft.write_bytes(shown.png)
        for table in (*section.tables, *section.data):
            with new_file(page.parent / f"{table.name}.csv", force) as draft:
                table.write_csv(draft)
    with new_file(page, force) as draft:
        write_page(title, lead, sections, draft)


def write_page(title: str, lead: Sequence[str], sections: Sequence[Section], path: Path) -> None:
    """Write the page; it refers to no other file."""
    parts = [f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{html.escape(title)}</title>"]
    parts.append(f"<style>{_STYLE}</style></head><body><h1>{html.escape(title)}</h1>")
    parts += [f"<p>{html.escape(paragraph)}</p>" for paragraph in lead]
    for section in sections:
        parts.append(f"<h2>{html.escape(section.title)}</h2>")
        parts += [f"<p>{html.escape(paragraph)}</p>" for paragraph in section.text]
        parts += [_table(table) for table in section.tables]
        for shown in section.pictures:
            caption = html.escape(shown.caption)
            parts.append(
                f"<figure><img src='{shown.as_data_uri()}' alt='{caption}'><figcaption>{caption}</figcaption></figure>"
            )
    parts.append("</body></html>\n")
    path.write_text("".join(parts), encoding="utf-8")


def _table(table: DataTable) -> str:
    head = "".join(
        f"<th class='{'text' if _holds_text(table, i) else ''}'>{html.escape(column)}</th>"
        for i, column in enumerate(table.heads or table.columns)
    )
    rows = "".join("<tr>" + "".join(_cell(value) for value in row) + "</tr>" for row in table.rows)
    return f"<table><caption>{html.escape(table.caption)}</caption><tr>{head}</tr>{rows}</table>"


def _holds_text(table: DataTable, column: int) -> bool:
    return any(isinstance(row[column], str) for row in table.rows[:1])


def _cell(value: Any) -> str:
    if isinstance(value, str):
        kind = value if value in ("agrees", "differs") else ""
        return f"<td class='text {kind}'>{html.escape(value)}</td>"
    return f"<td>{number_text(value)}</td>"


def number_text(value: Any) -> str:
    """A number for people: four digits, `none` for what does not exist."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
