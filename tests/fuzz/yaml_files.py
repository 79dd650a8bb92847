"""YAML files of ours: parameters, presets, plans, targets, calibrations, in the hands of everything that loads them."""

import os
import re
from pathlib import Path

from hypothesis import strategies as st

from squeal_rig.catalogue.checking import check_file
from squeal_rig.configuration.files import config_directory, load_yaml
from squeal_rig.estimation.calibration.problem import load_calibration
from squeal_rig.estimation.calibration.targets import load_targets
from squeal_rig.experiments.plan import load_plan
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model.parameters import RigParameters

from . import Case
from .bounded import command

#: Values that some reader of YAML takes for more, or for less, than they are.
ODD_VALUES = (
    *("", "~", "null", "true", "yes", "''", "[]", "{}", "0", "-0", "-1", "1", "1e-320", "1e308", "1e400", "-1e400"),
    *(".nan", ".inf", "-.inf", "0x10", "0o17", "1_000", "6e7", "1e-05", "12:30:45", "2020-99-99", "2001-01-01"),
    *("9" * 400, "-" + "9" * 25, "0." + "3" * 400, "18446744073709551616", "'1e-05'", "!!float x", "!!int ''"),
    *("!!binary x", "!!python/object/apply:os.getcwd []", "!!set {a, b}", "&a [*a]", "*b", "&a 1", "<<", "|", ">"),
    *("[1, 2]", "[[[[1]]]]", "{a: {b: {c: 1}}}", "{1: 2}", "{[1]: 2}", "? x", "- x", "[/x]", "'[/x]'", "'[bold]'"),
    *(
        '"\\0"',
        '"\\e[31m"',
        '"\\ud800"',
        '"\\U0010ffff"',
        "'\t'",
        "\u00e9\u4e2d",
        "\u2028",
        "@",
        "`",
        "%",
        "#",
        "{[",
        "[" * 60,
    ),
    *("x" * 5000, "../../../../etc/hostname", "/dev/zero", "/dev/stdin", ".", "/", "..", "\\"),
)
#: Lines that do not belong where they are put.
ODD_LINES = (
    *("1: 2", "? [1, 2]\n: 3", "<<: {a: 1}", "~: ~", "null:", "'': x", "- x", "  - x", "\t", "---", "...", "%YAML 1.1"),
    *("a: &a [1]\nb: *a", "{}", "]", "x: |\n  text", "\ufeff", "a: b: c", "true: false", ".nan: 1", "!!x y: z"),
    *("ros__parameters: [1]", "ros__parameters:", "/**:\n  ros__parameters: {preload: 50.0}", "steps: {}", "free: 3"),
    *("targets: .", "targets: {x: 1}", "preset: [x]", "critical_pad_stiffness: [[]]", "tare_x: .nan", "set: [1]"),
)
_LOADERS = {
    "preset": RigParameters.from_yaml,
    "plan": load_plan,
    "targets": load_targets,
    "calibration": load_calibration,
}


@st.composite
def odd_texts(draw, text, most=4):
    """A text of lines with a few of them spoilt: another value, another name, moved, twice, gone, cut off."""
    lines = text.split("\n")
    for _ in range(draw(st.integers(1, most))):
        at = draw(st.integers(0, max(len(lines) - 1, 0)))
        line = lines[at] if lines else ""
        how = draw(
            st.sampled_from(("value", "value", "inner", "name", "line", "double", "drop", "indent", "cut", "letter"))
        )
        if how == "value":
            lines[at : at + 1] = [line.partition(":")[0] + ": " + draw(st.sampled_from(ODD_VALUES))]
        elif how == "inner":  # of a flow mapping or list
            values = list(re.finditer(r"(?<=[:\[,] )?[\w.+-]+(?=[,}\]])", line))
            if values:
                found = draw(st.sampled_from(values))
                lines[at] = line[: found.start()] + draw(st.sampled_from(ODD_VALUES)) + line[found.end() :]
        elif how == "name":
            indent = line[: len(line) - len(line.lstrip())]
            lines[at : at + 1] = [indent + draw(st.sampled_from(ODD_VALUES)) + ":" + line.partition(":")[2]]
        elif how == "line":
            indent = draw(st.sampled_from(("", line[: len(line) - len(line.lstrip())])))
            lines.insert(at, indent + draw(st.sampled_from(ODD_LINES)))
        elif how == "double":
            lines.insert(draw(st.integers(0, len(lines))), line)
        elif how == "drop":
            del lines[at : at + draw(st.integers(1, 3))]
        elif how == "indent":
            lines[at : at + 1] = [" " * draw(st.integers(0, 5)) + line.lstrip()]
        elif how == "cut":
            lines = lines[: at + 1]
        else:
            place = draw(st.integers(0, len(line)))
            lines[at : at + 1] = [line[:place] + draw(st.characters()) + line[place:]]
    return "\n".join(lines)


def encoded(text):
    """UTF-8, of what is no text as well."""
    return text.encode("utf-8", "surrogatepass")


def _sources():
    folder = config_directory()
    texts = {
        "rig": (folder / "rig.yaml").read_text(encoding="utf-8"),
        "springs": (folder / "springs.yaml").read_text(encoding="utf-8"),
        "description": RigDescription(RigParameters.preset("yavuz_sen_2023")).to_yaml(),
    }
    for kind in ("presets", "plans", "paper", "calibrations", "drivers"):
        for path in sorted((folder / kind).glob("*.yaml")):
            texts[path.stem if kind == "presets" else f"{kind}_{path.stem}"] = path.read_text(encoding="utf-8")
    return texts


def make_corpus(folder):
    """Every YAML file that ships, and a description of the rig."""
    for name, text in _sources().items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")


def bombs():
    """Texts that are short, and stand for much."""
    aliases = "a: &a [x, x, x, x, x, x, x, x, x]\n"
    for name, before in zip("bcdefghi", "abcdefgh", strict=True):
        aliases += f"{name}: &{name} [{', '.join(9 * [f'*{before}'])}]\n"
    return {
        "aliases": aliases,
        "deep": "[" * 60_000,
        "deep_mappings": "{a: " * 20_000,
        "long_line": "a: " + "x" * 60_000,
        "many_keys": "".join(f"k{number}: 1\n" for number in range(7000)),
        "many_steps": "steps:\n" + "  - wait: 1\n" * 5000,
        "million": "a: 1\n" * 200_000,
        "digits": "mass: " + "9" * 60_000,
        "anchors": "".join(f"k{number}: &k{number} 1\n" for number in range(4000)),
        "merges": "a: &a {x: 1}\n" + "b: {<<: *a}\n" * 2000,
        "zeros": "\0" * 1000,
        "utf16": "\ufeffa: 1".encode("utf-16").decode("latin-1"),
    }


def made(_corpus):
    """Bombs, and files that are no files."""
    for name, text in bombs().items():
        yield Case({"file.yaml": encoded(text)}, {"made": name})
    for place in ("/dev/zero", "/dev/null", "fifo", "folder", "missing", "a\0b", "x" * 5000):
        yield Case({}, {"place": place.replace("\0", "<NUL>")})


def cases(corpus):
    """Files that ship, spoilt, as they would be passed to a command."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(corpus.glob("*.yaml"))]
    spoilt = st.sampled_from(texts).flatmap(odd_texts).map(encoded)
    return spoilt.map(lambda data: Case({"file.yaml": data}))


def prepare(_corpus):
    """Lay out the folders that a calibration points to, and places that are no files."""
    Path("calibrations").mkdir()
    os.symlink(config_directory() / "paper", "paper")
    os.mkfifo("fifo")
    Path("folder").mkdir()


def examine(case, notes):
    """Check the file, load it as whatever it may be meant for; what `check` calls in order is loaded without a word."""
    path = Path("calibrations/file.yaml")
    if "place" in case.facts:
        path = case.facts["place"].replace("<NUL>", "\0")
    else:
        path.write_bytes(case.files["file.yaml"])
    said = notes.step("check", check_file, path)
    if "made" in case.facts:
        return  # refused or not, it took its time
    if "\0" not in str(path):  # no command line holds one
        notes.step("squeal-rig check", command, "check", path)
    loaded = {kind: notes.step(kind, loader, path) for kind, loader in _LOADERS.items()}
    content = notes.step("load_yaml", load_yaml, path)
    if "place" not in case.facts:
        text = case.files["file.yaml"].decode("utf-8", "replace")
        notes.step("description", RigDescription.from_yaml, text)
    if said is None:
        return
    meant = {"a plan": "plan", "rig parameters": "preset", "a calibration": "calibration"}
    kind = next((kind for words, kind in meant.items() if said.startswith(words)), None)
    kind = "targets" if kind is None and "targets of a calibration" in said else kind
    if (kind is not None and loaded[kind] is None) or not isinstance(content, dict):
        notes.wrong(f"check says {said!r}, and loading it as {kind} is refused")
