"""Compiled code on disk is run only where nobody else could have put it there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import squeal_rig
from squeal_rig.model.core.code_cache import why_not_trusted

_STRANGER = 4711
_needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "kernel.py"
    path.touch()
    return path


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "cache"
    path.mkdir(mode=0o755)
    (path / "law.nbi").touch()
    return path


def test_a_folder_of_our_own_is_trusted(folder, source):
    assert why_not_trusted(folder, source) is None


@pytest.mark.parametrize(("mode", "who"), [(0o777, "everybody"), (0o757, "everybody")])
@pytest.mark.parametrize("what", ["folder", "file", "parent"])
def test_what_everybody_can_write_is_not(folder, source, mode, who, what):
    path = {"folder": folder, "file": folder / "law.nbi", "parent": folder.parent}[what]
    before = path.stat().st_mode
    path.chmod(mode)
    try:
        assert why_not_trusted(folder, source) == f"{path} can be written by {who}"
    finally:
        path.chmod(before)


def test_a_sticky_folder_above_is_no_fault(folder, source):
    folder.parent.chmod(0o1777)
    assert why_not_trusted(folder, source) is None


def test_a_link_among_the_files_is_not_followed(folder, source):
    (folder / "other.nbc").symlink_to(source)
    assert why_not_trusted(folder, source) == f"{folder / 'other.nbc'} is a link"


@_needs_root
def test_what_a_stranger_owns_is_not_trusted_unless_the_package_is_his(folder, source):
    os.chown(folder / "law.nbi", _STRANGER, 0)
    assert f"belongs to user {_STRANGER}" in why_not_trusted(folder, source)
    os.chown(source, _STRANGER, 0)
    why_not_trusted.cache_clear()
    assert why_not_trusted(folder, source) is None


@_needs_root
def test_a_folder_shared_by_a_group_is_not_trusted(folder, source):
    os.chown(folder, 0, _STRANGER)
    folder.chmod(0o775)
    assert why_not_trusted(folder, source) == f"{folder} can be written by the group {_STRANGER}"


# Without the rest of the model, which would be compiled as well.
_MODULE = """
import sys, types
from pathlib import Path
import squeal_rig

for name in ("model", "model/core"):
    package = sys.modules["squeal_rig." + name.replace("/", ".")] = types.ModuleType(name)
    package.__path__ = [str(Path(squeal_rig.__file__).parent / name)]

from squeal_rig.model.core.kernel import kernel

@kernel
def twice(x):
    return 2.0 * x
"""

# Numba reads its version, then a pickle: what is planted there runs.
_PLANT = """
import pickle, sys
from pathlib import Path
import numba
class Trap:
    def __reduce__(self):
        return Path.touch, (Path(sys.argv[2]),)
for index in Path(sys.argv[1]).rglob("mine.twice*.nbi"):
    index.write_bytes(pickle.dumps(numba.__version__) + pickle.dumps(Trap()))
"""


@pytest.mark.slow
def test_code_that_was_planted_in_a_shared_folder_is_not_run_and_a_sentence_says_so(tmp_path):
    folder, fell = tmp_path / "shared", tmp_path / "fell"
    (tmp_path / "mine.py").write_text(_MODULE, encoding="utf-8")
    paths = os.pathsep.join((str(Path(squeal_rig.__file__).parents[1]), str(tmp_path)))

    def python(code, *arguments):
        return subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)],
            env={**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": paths},
            capture_output=True,
            text=True,
            check=False,
        )

    use = "import mine; print(mine.twice(2.0))"
    assert python(use).stdout == "4.0\n"
    assert python(_PLANT, folder, fell).returncode == 0
    (cache,) = {path.parent for path in folder.rglob("mine.twice*.nbi")}
    cache.chmod(0o777)
    shared = python(use)
    assert shared.stdout == "4.0\n"
    assert f"{cache} can be written by everybody" in shared.stderr
    assert not fell.exists()
    # The trap is a real one: in a folder that is ours alone, numba falls into it.
    cache.chmod(0o755)
    python(use)
    assert fell.exists()
