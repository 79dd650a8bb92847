"""docs/architecture.md against the tree: every file of the package has its place on the page, and no other is named."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "squeal_rig"
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def room_rows():
    """Room (as a path in the package) -> file names that its row of a table gives."""
    rows = {}
    for line in PAGE.splitlines():
        match = re.match(r"\| `([a-z_/]+?)/?` \| (.*) \|$", line)
        if match:
            # What stands in brackets describes; a name in it is no file.
            files = re.sub(r"\([^()]*\)", "", match.group(2))
            rows[match.group(1)] = re.findall(r"`([a-z_0-9]+)`", files)
    return rows


def modules(folder):
    return sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")


def test_every_file_of_a_room_is_named_once_on_the_page_and_none_that_is_not_there():
    rooms = room_rows()
    assert len(rooms) >= 15
    for room, names in rooms.items():
        assert sorted(names) == modules(PACKAGE / room), room


def test_every_room_is_on_the_page():
    folders = {
        str(path.parent.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.py") if path.name != "__init__.py"
    } - {"."}
    assert folders == set(room_rows())
    picture = PAGE.split("## ")[0]
    for room in {folder.split("/")[0] for folder in folders} | set(modules(PACKAGE)):
        assert re.search(rf"\b{room}\b", picture), room
