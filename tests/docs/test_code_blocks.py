"""Blocks of code are in order: commands, options, nodes, parameters and names exist; Python that needs no rig runs."""

import ast
import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
from itertools import pairwise

import click
import pytest
import typer
import yaml

from squeal_rig.catalogue.checking import check_file
from squeal_rig.cli import app
from squeal_rig.nodes.start import NODES

from .pages import DOCS, PAGES, ROOT, TUTORIALS, blocks

_BLOCKS = [(page, block) for page in PAGES for block in blocks(page)]
_REFERENCE = ROOT / "bags" / "reference"
_WITH_PYTHON = sorted({page for page, block in _BLOCKS if block.language == "python"} - set(TUTORIALS))


def _of(language, pages=PAGES):
    return [
        pytest.param(block.text, id=f"{page.relative_to(ROOT)}:{block.line}")
        for page, block in _BLOCKS
        if block.language == language and page in pages
    ]


def test_every_block_is_in_a_language_that_is_checked():
    known = {"bash", "python", "yaml", "text", "{toctree}", "{eval-rst}"}
    assert [(page.name, block.line) for page, block in _BLOCKS if block.language not in known] == []


@pytest.mark.parametrize("text", _of("yaml") or [pytest.param("{}", id="no page has any")])
def test_yaml_can_be_read(text):
    assert yaml.safe_load(text) is not None


@pytest.mark.parametrize("text", _of("yaml", [DOCS / "files.md"]))
def test_a_file_of_each_kind_is_in_order(text, tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text(text, encoding="utf-8")
    assert check_file(path)


@pytest.mark.parametrize("text", _of("python"))
def test_python_compiles_and_what_it_imports_is_there(text):
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("squeal_rig"):
            module = importlib.import_module(node.module)
            assert [name.name for name in node.names if not hasattr(module, name.name)] == []


@pytest.mark.docs
@pytest.mark.parametrize("page", _WITH_PYTHON, ids=lambda page: page.name)
def test_python_of_a_page_runs_from_top_to_bottom(page, tmp_path):
    shutil.copytree(_REFERENCE, tmp_path / "bags" / "run1")
    code = "\n".join(block.text for block in blocks(page) if block.language == "python")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# --- shell


@pytest.mark.parametrize("text", _of("bash"))
def test_commands_options_nodes_and_parameters_exist(text):
    for command in _commands(text):
        _check(command)


def _commands(text):
    """Words of every single command, heredocs and what substitutes left out."""
    text = re.sub(r"<<'(\w+)'.*?^\1$", "", text, flags=re.S | re.M)
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        part = []
        for word in [*words, "&&"]:
            if word in ("&&", "||", ";", "|", "&"):
                if part:
                    yield part
                part = []
            else:
                part.append(word)


def _check(words):
    while words and ("=" in words[0] or words[0] == "RUN"):
        words = words[1:]
    if words[:1] == ["squeal-rig"]:
        _check_squeal_rig(words[1:])
    elif words[:1] == ["make"]:
        _check_make(words[1:])
    elif words[:2] in (["python", "-m"], ["python3", "-m"], ["pytest", "--pyargs"]):
        assert words[2] == "venv" or importlib.util.find_spec(words[2]), words
    elif words[:3] == ["ros2", "run", "squeal_rig"]:
        _check_node(words[3], words[4:])
    elif words[:3] == ["ros2", "param", "set"]:
        assert words[4] in _parameters(words[3].strip("/")), words
    elif words[:3] == ["ros2", "launch", "squeal_rig"]:
        launch = (ROOT / "launch" / words[3]).read_text(encoding="utf-8")
        for argument in words[4:]:
            assert f'"{argument.partition(":=")[0]}"' in launch, argument
    elif words[:2] in (["ros2", "service"], ["ros2", "topic"]):
        policy = (ROOT / "config" / "security" / "policy.xml").read_text(encoding="utf-8")
        name = next(word for word in words[3:] if not word.startswith("-")).strip("/")
        assert f"<{words[1]}>{name}</{words[1]}>" in policy, words


def _check_squeal_rig(words):
    command, context = typer.main.get_command(app), None
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"squeal-rig has no command {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    if "--help" in words:
        return
    words = words[: words.index(">")] if ">" in words else words
    context = click.Context(command)
    try:
        # As the parser sees them; whether files exist is another matter.
        command.make_parser(context).parse_args(list(words))
    except click.UsageError as error:
        pytest.fail(f"squeal-rig {' '.join(words)}: {error}")


def _check_make(words):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for word in words:
        name, _, value = word.partition("=")
        if value:
            assert re.search(rf"\b{name}\b", makefile), word
        else:
            assert re.search(rf"^{word}:", makefile, re.M), word


def _check_node(node, words):
    assert node in NODES, node
    for flag, value in pairwise(words):
        if flag == "-p":
            assert value.partition(":=")[0] in {*_parameters(node), "use_sim_time"}, value


def _parameters(node):
    """Names in the table of parameters, which is made from the code."""
    text = (DOCS / "parameters.md").read_text(encoding="utf-8")
    node = "rig" if node == "simulator" else node
    section = re.search(rf"^## {node}$(.*?)(^## |\Z)", text, re.S | re.M)
    assert section, node
    return set(re.findall(r"^\| `(\w+)`", section[1], re.M))
