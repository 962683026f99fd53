"""The ament package: its executable is `pnm serve`, and its files say the same as those of the project."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import version
from xml.etree import ElementTree

import yaml

from tests.support.files import ROOT

PACKAGE = ROOT / "ros" / "pnm"


def test_the_executable_is_the_command():
    assert (PACKAGE / "scripts" / "serve").stat().st_mode & 0o111 == 0o111
    told = subprocess.run(
        [sys.executable, str(PACKAGE / "scripts" / "serve"), "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=PACKAGE,
        env={"PYTHONPATH": str(ROOT)},
    )
    assert "serve [OPTIONS] [DOMAIN] [PROBLEM]" in told.stdout
    assert "--on-conflict" in told.stdout


def test_name_and_version_are_those_of_the_project():
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert [package.findtext(name) for name in ("name", "version", "license")] == ["pnm", project["version"], project["license"]]


def test_the_version_is_written_once_and_repeated_without_a_mistake():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert [cited[name] for name in ("version", "license", "keywords")] == [project[name] for name in ("version", "license", "keywords")]
    newest = next(line for line in (ROOT / "CHANGELOG.md").read_text().splitlines() if line.startswith("## "))
    assert newest.removeprefix("## ").partition(",")[0] == project["version"]
    assert version("petri-net-machines") == project["version"], "installed anew after a change"


def test_our_messages_have_one_version():
    ours = ROOT / "ros" / "pnm_interfaces"
    package = ElementTree.parse(ours / "package.xml").getroot()
    project = tomllib.loads((ours / "pyproject.toml").read_text())["project"]
    assert [package.findtext(name) for name in ("version", "license")] == [project["version"], project["license"]]
    assert f"`pnm_interfaces` {project['version']}" in (ROOT / "CHANGELOG.md").read_text()


def test_what_is_launched_is_what_is_installed():
    launch = ast.parse((PACKAGE / "launch" / "serve.launch.py").read_text())
    (node,) = (one for one in ast.walk(launch) if isinstance(one, ast.Call) and getattr(one.func, "id", "") == "LifecycleNode")
    said = {word.arg: word.value.value for word in node.keywords if isinstance(word.value, ast.Constant)}
    assert (said["package"], said["executable"]) == ("pnm", "serve")
    assert "scripts/serve" in (PACKAGE / "CMakeLists.txt").read_text()
