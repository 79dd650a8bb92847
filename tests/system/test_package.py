"""What is built is what the package needs, whole and nothing else; what it asks for exists."""

import runpy
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from squeal_rig.configuration.files import config_directory
from squeal_rig.nodes.start import NODES

ROOT = Path(__file__).parents[2]
_DATA = "squeal_rig-{version}.data/data/"


@pytest.fixture(scope="module")
def metadata():
    """The arguments of `setup()`."""
    arguments = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr("setuptools.setup", arguments.update)
        runpy.run_path("setup.py")
    return arguments


def _files(*folders):
    return {
        str(path.relative_to(ROOT))
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Names in the sdist, and the wheel that is made of that sdist."""
    work = tmp_path_factory.mktemp("built")
    left_out = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist", "bags", "docs", "benchmarks")
    shutil.copytree(ROOT, work / "clean", ignore=left_out)

    def build(kind, folder):
        script = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(work)!r}))"
        done = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return work / done.stdout.splitlines()[-1]

    with tarfile.open(build("sdist", work / "clean")) as archive:
        names = {name.partition("/")[2] for name in archive.getnames() if not archive.getmember(name).isdir()}
        archive.extractall(work / "sdist", filter="data")
    (folder,) = (work / "sdist").iterdir()
    return names, build("wheel", folder)


def test_the_wheel_holds_the_package_and_what_ros_looks_for_and_nothing_else(built, metadata):
    data = _DATA.format(version=metadata["version"])
    expected = _files("squeal_rig")
    expected |= {f"{data}share/squeal_rig/{name}" for name in _files("config", "launch") | {"package.xml"}}
    expected |= {f"{data}lib/squeal_rig/{Path(name).name}" for name in _files("scripts")}
    expected |= {f"{data}share/ament_index/resource_index/packages/squeal_rig"}
    with zipfile.ZipFile(built[1]) as wheel:
        found = {name for name in wheel.namelist() if ".dist-info/" not in name}
        scripts = [wheel.getinfo(name) for name in found if f"{data}lib/" in name]
    assert found == expected
    assert "squeal_rig/py.typed" in found
    assert {info.external_attr >> 16 & 0o111 for info in scripts} == {0o111}


def test_the_sdist_holds_what_the_wheel_is_made_of_and_nothing_else(built):
    found = {name for name in built[0] if ".egg-info/" not in name}
    expected = _files("squeal_rig", "config", "launch", "scripts", "resource")
    expected |= {"setup.py", "setup.cfg", "pyproject.toml", "MANIFEST.in", "package.xml", "PKG-INFO"}
    expected |= {"README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff"}
    assert found == expected


def test_every_node_has_its_script_and_every_script_its_node():
    assert {Path(name).name for name in _files("scripts")} == set(NODES)


def test_versions_and_licence_agree_wherever_they_stand(metadata):
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert manifest.findtext("version") == metadata["version"] == citation["version"]
    assert manifest.findtext("license") == metadata["license"] == citation["license"]
    assert manifest.findtext("description") == metadata["description"]


def test_every_key_of_the_manifest_is_on_the_published_list():
    published = yaml.safe_load((ROOT / "tests" / "system" / "rosdep_keys.yaml").read_text(encoding="utf-8"))
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    asked = {element.text for element in manifest if element.tag.endswith("depend")}
    assert asked == {*published["jazzy"], *published["rosdep"]}


def test_every_dependency_has_a_lower_bound(metadata):
    extras = metadata["extras_require"]
    asked = [
        *metadata["install_requires"],
        *(name for extra, names in extras.items() if extra != "colcon" for name in names),
    ]
    assert [requirement for requirement in asked if ">=" not in requirement] == []


def test_the_page_on_installing_has_every_extra(metadata):
    page = (ROOT / "docs" / "how_to" / "install.md").read_text(encoding="utf-8")
    assert [extra for extra in metadata["extras_require"] if f"`{extra}`" not in page] == []


def test_the_configuration_is_found_beside_the_package():
    assert config_directory() == ROOT / "config"
