"""Pages of the reference that are made from the code when the site is built: commands, Python."""

import inspect
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import click
import typer

_HEAD = "<!-- made from the code when the site is built; do not edit -->\n"

#: Public modules, as scripts import them.
MODULES = (
    "squeal_rig.model",
    "squeal_rig.recording",
    "squeal_rig.samples.frames",
    "squeal_rig.estimation.friction",
    "squeal_rig.estimation.regression",
    "squeal_rig.estimation.spectra",
    "squeal_rig.instruments.driver",
    "squeal_rig.errors",
)


def write_reference(folder: Path) -> None:
    """Write the generated pages, each only where it has changed."""
    for name, text in (("commands.md", commands()), ("python.md", python())):
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def commands() -> str:
    """Every command of `squeal-rig` with its arguments and options, as `--help` tells them."""
    from squeal_rig.cli import app

    lines = [
        _HEAD,
        "# Commands",
        "",
        "What `squeal-rig COMMAND --help` says. Bad input is one sentence and exit code 2.",
    ]
    for words, command in _leaves(typer.main.get_command(app), ("squeal-rig",)):
        usage = command.collect_usage_pieces(click.Context(command))
        lines += ["", f"## {' '.join(words)}", "", inspect.cleandoc(command.help or ""), ""]
        lines += ["```text", " ".join((*words, *usage)), "```", ""]
        shown = [parameter for parameter in command.params if _help(parameter)]
        if shown:
            lines += ["| | |", "|---|---|"]
            lines += [f"| `{_name(parameter)}` | {_help(parameter)} |" for parameter in shown]
    return "\n".join(lines) + "\n"


def _leaves(command: click.Command, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    if hasattr(command, "commands"):
        for name, below in command.commands.items():
            yield from _leaves(below, (*words, name))
    else:
        yield words, command


def _name(parameter: click.Parameter) -> str:
    both = [*parameter.opts, *parameter.secondary_opts]
    return (
        " / ".join(both)
        if parameter.param_type_name == "option"
        else (parameter.metavar or (parameter.name or "").upper())
    )


def _help(parameter: click.Parameter) -> str:
    return (getattr(parameter, "help", None) or "").replace("|", "\\|")


def python() -> str:
    """Every public name of the modules that scripts import from, by Sphinx's autodoc."""
    lines = [_HEAD, "# Python", "", "All numbers are SI floats. Units stand in brackets, sources in the docstrings."]
    for module in MODULES:
        public = import_module(module)
        summary = inspect.cleandoc(public.__doc__ or "").split("\n\n")[0]
        names = getattr(public, "__all__", None) or _own_names(public)
        lines += ["", f"## {module}", "", summary, "", "```{eval-rst}", f".. currentmodule:: {module}", ""]
        for name in sorted(names):
            kind = "class" if inspect.isclass(getattr(public, name)) else "function"
            if callable(getattr(public, name)):
                lines += [f".. auto{kind}:: {name}", *(["   :members:"] if kind == "class" else [])]
        lines += ["```"]
    return "\n".join(lines) + "\n"


def _own_names(module: object) -> list[str]:
    name = getattr(module, "__name__", "")
    return [
        own
        for own, value in vars(module).items()
        if not own.startswith("_") and getattr(value, "__module__", None) == name and callable(value)
    ]
