"""What sentences name is there: files, modules, commands with their options, targets of make."""

import re
import shlex

import pytest
import typer

from squeal_rig.cli import app

from .pages import PAGES, ROOT

# A path is told from the root, from the package, from its model, or as it is installed.
_FROM = (ROOT, ROOT / "squeal_rig", ROOT / "squeal_rig" / "model", ROOT / "docs")
_PATH = re.compile(r"`([\w.-]+(?:/[\w.-]+)+\.(?:py|yaml|xml|md|csv|json))`|\b((?:config|docs|tests)/[\w/.-]+\.\w+)")
_MODULE = re.compile(r"\bsqueal_rig(?:\.[a-zA-Z_]\w*)+")


def _names(pattern):
    return [
        pytest.param(page, sorted({next(filter(None, match.groups()), match[0]) for match in found}), id=page.name)
        for page in PAGES
        if (found := list(re.finditer(pattern, page.read_text(encoding="utf-8"))))
    ]


@pytest.mark.parametrize(("page", "names"), _names(_PATH))
def test_every_file_that_is_named_is_there(page, names):
    gone = []
    for name in names:
        path = name.removeprefix("share/squeal_rig/")
        if not any((folder / path).exists() for folder in (*_FROM, page.parent)):
            gone.append(name)
    assert gone == []


@pytest.mark.parametrize(("page", "names"), _names(r"`([^`\n]*squeal_rig\.[a-zA-Z_][^`\n]*)`"))
def test_every_module_that_is_named_is_there(page, names):
    dotted = {match[0] for name in names for match in re.finditer(_MODULE, name)}
    assert [name for name in sorted(dotted) if not _is_there(name)] == []


def _is_there(dotted):
    """Whether it is a module, a name in one, or a group of entry points."""
    if dotted == "squeal_rig.drivers":
        return True
    path = ROOT.joinpath(*dotted.split("."))
    if path.with_suffix(".py").exists() or path.is_dir():
        return True
    above, name = path.parent, path.name
    source = next((file for file in (above.with_suffix(".py"), above / "__init__.py") if file.exists()), None)
    return source is not None and re.search(rf"\b{name}\b", source.read_text(encoding="utf-8")) is not None


@pytest.mark.parametrize(("page", "names"), _names(r"`(squeal-rig [^`]+)`"))
def test_every_command_that_is_named_is_there_with_its_options(page, names):
    for name in names:
        command, words = typer.main.get_command(app), [word.strip(",[]") for word in shlex.split(name)[1:]]
        while hasattr(command, "commands") and words and words[0].islower() and not words[0].startswith("-"):
            assert words[0] in command.commands, name
            command, words = command.commands[words[0]], words[1:]
        known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        assert {word for word in words if word.startswith("--")} - known - {"--help"} == set(), name


@pytest.mark.parametrize(("page", "names"), _names(r"`(make [a-z][^`]*)`"))
def test_every_target_of_make_that_is_named_is_there(page, names):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = {name.split()[1] for name in names if "=" not in name.split()[1]}
    assert [target for target in sorted(targets) if not re.search(rf"^{target}:", makefile, re.M)] == []
