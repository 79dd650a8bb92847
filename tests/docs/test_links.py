"""No link leads nowhere, and every page is found from the front page."""

import pytest

from .pages import DOCS, PAGES, ROOT, contents, headings, links

_MADE = ("reference/commands.md", "reference/python.md")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    dead = []
    for target, line in links(page):
        path, _, anchor = target.partition("#")
        file = (page.parent / path) if path else page
        if not file.exists():
            dead.append(f"line {line}: {target}")
        elif anchor and file.suffix == ".md" and anchor not in headings(file):
            dead.append(f"line {line}: {target} (no such heading)")
    assert dead == []


def test_every_page_of_the_docs_is_in_the_contents():
    listed, waiting = set(), [DOCS / "index.md"]
    while waiting:
        page = waiting.pop().resolve()
        if page in listed or not page.exists():
            continue
        listed.add(page)
        waiting += contents(page)
    missing = {page for page in PAGES if DOCS in page.parents} - listed
    assert sorted(str(page.relative_to(DOCS)) for page in missing) == []


def test_every_page_in_the_contents_exists():
    named = {page.resolve() for source in PAGES for page in contents(source)}
    gone = {page for page in named if not page.exists()} - {(DOCS / name).resolve() for name in _MADE}
    assert sorted(map(str, gone)) == []
