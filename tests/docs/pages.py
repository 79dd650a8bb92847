"""Pages of the documentation, their blocks of code and their links."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
_GENERATED = (DOCS / "reference" / "commands.md", DOCS / "reference" / "python.md")
#: Every page that a user reads, but those that the site's build writes.
PAGES = sorted(
    page
    for page in (ROOT / "README.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md"))
    if page not in _GENERATED and "_build" not in page.parts
)
TUTORIALS = sorted(page for page in (DOCS / "tutorials").glob("*.md") if page.stem != "index")
_SHELL = (
    "squeal-rig ",
    "make ",
    "ros2 ",
    ". ",
    "pip ",
    "python",
    "rosdep ",
    "colcon ",
    "cd ",
    "sudo ",
    "export ",
    "RUN ",
)


@dataclass(frozen=True)
class Block:
    """A block of code: the language it is in, its text, the line it begins in."""

    language: str
    text: str
    line: int


def blocks(page):
    """All blocks of a page: fenced ones by their label, indented ones by what they look like."""
    found, lines = [], page.read_text(encoding="utf-8").splitlines()
    number = 0
    while number < len(lines):
        line = lines[number]
        begin = number + 1
        if fence := re.match(r"( *)(`{3,})(\S*)", line):
            end = next(n for n in range(begin, len(lines)) if lines[n].strip() == fence[2])
            indent = len(fence[1])
            text = "\n".join(row[indent:] for row in lines[begin:end])
            found.append(Block(fence[3], text, begin))
            number = end + 1
        elif line.startswith("    ") and (number == 0 or not lines[number - 1].strip()):
            end = begin
            while end < len(lines) and (lines[end].startswith("    ") or not lines[end].strip()):
                end += 1
            text = "\n".join(row[4:] for row in lines[number:end]).rstrip()
            found.append(Block(_guess(text), text, begin))
            number = end
        else:
            number += 1
    return found


def _guess(text):
    first = text.lstrip()
    if first.startswith(("import ", "from ")):
        return "python"
    return "bash" if first.startswith(_SHELL) else "text"


def headings(page):
    """Anchors of a page, as GitHub and MyST make them of its headings."""
    found = set()
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            words = re.sub(r"[^\w\- ]", "", line.lstrip("#").strip().lower())
            found.add(words.replace(" ", "-"))
    return found


def links(page):
    """(target, line) of every link and picture of a page that leads to a file or a heading of ours."""
    text = re.sub(r"^( *)```.*?^\1```", lambda m: "\n" * m[0].count("\n"), page.read_text("utf-8"), flags=re.S | re.M)
    for match in re.finditer(r"\]\(([^)\s]+)\)", text):
        if not match[1].startswith(("http://", "https://", "mailto:")):
            yield match[1], text.count("\n", 0, match.start()) + 1


def contents(page):
    """Pages that the tables of contents of a page name."""
    for block in blocks(page):
        if block.language == "{toctree}":
            for name in block.text.splitlines():
                if name.strip() and not name.startswith(":"):
                    found = sorted(f for f in page.parent.glob(f"{name.strip()}.*") if f.suffix in (".md", ".ipynb"))
                    yield from found or ([] if "*" in name else [page.parent / f"{name.strip()}.md"])
