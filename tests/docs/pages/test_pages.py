"""Every page of the docs: its commands print what it shows, its pictures are what they draw, its links lead somewhere."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from planner_bridge.cli.commands import app
from tests.support.docs.page import DOCS, NOT_RUN, PAGES, PICTURES, Block, blocks_of
from tests.support.docs.pages import SIMULATED, differences
from tests.support.files import ROOT

LINKING = (*PAGES, ROOT / "CHANGELOG.md", ROOT / "ros" / "pnm" / "README.md")
LINK = re.compile(r"\]\((?![a-z]+://)([^)#\s]*)(?:#([^)]*))?\)")
DRAWN = re.compile(r"(?:-o|--timeline) ([\w-]+\.svg)")


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def anchors(page: Path) -> set[str]:
    """The anchors of a page, as GitHub makes them of its headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = (heading.replace("`", "").lower() for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE))
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in headings}


def commands(block: Block) -> Iterator[list[str]]:
    """The commands of `pnm` in a block that is not run: words, without comments, and without what other programs do with them."""
    for line in block.body.splitlines():
        for part in re.split(r"&&|\||;", line.removeprefix("$ ")):
            words = shlex.split(part, comments=True)
            if words and words[0].split("/")[-1] == "pnm":
                yield words[1:]


@pytest.mark.parametrize("page", SIMULATED, ids=name)
def test_a_page_shows_what_is_printed_and_drawn(page: Path, tmp_path: Path) -> None:
    lines = "".join(differences(page, tmp_path))
    assert not lines, f"python -m tests.support.docs.pages --write {name(page)} puts in what is so\n{lines}"


@pytest.mark.parametrize("page", LINKING, ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    for target, anchor in LINK.findall(re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)):
        file = (page.parent / target).resolve() if target else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), f"{target}#{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_blocks_of_consoles_are_run_or_say_that_they_are_not(page: Path) -> None:
    for block in blocks_of(page.read_text(encoding="utf-8"), "console"):
        assert block.name in ("", NOT_RUN) or block.name.startswith("terminal "), block.name


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_that_are_not_run_have_only_options_that_there_are(page: Path) -> None:
    blocks = [block for block in blocks_of(page.read_text(encoding="utf-8")) if block.kind == "sh" or block.name == NOT_RUN]
    for words in (words for block in blocks for words in commands(block)):
        command = app.get_command(click.Context(app), words[0])
        assert command, words
        known = {option for parameter in command.params for option in parameter.opts} | {"-h", "--help"}
        own = words[1 : words.index("--ros-args")] if "--ros-args" in words else words[1:]
        assert {word.partition("=")[0] for word in own if word.startswith("-")} <= known, words


def test_the_robot_of_the_tutorial_needs_no_package_of_the_tests() -> None:
    code = "import sys; sys.modules.update(dict.fromkeys(('pytest', 'hypothesis'))); import tests.support.e2e.newcomer.porter"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_index_has_every_page() -> None:
    index = DOCS / "README.md"
    listed = {(DOCS / target).resolve() for target, _ in LINK.findall(index.read_text(encoding="utf-8")) if target}
    assert set(DOCS.rglob("*.md")) - {index} <= listed


def test_every_picture_of_a_net_or_a_plan_is_drawn_by_a_command_of_a_page() -> None:
    drawn = {file for page in SIMULATED for file in DRAWN.findall(page.read_text(encoding="utf-8"))}
    assert {picture.name for picture in PICTURES.glob("*.svg")} <= drawn


def test_a_level_of_the_docs_has_at_most_twelve_entries() -> None:
    for folder in (DOCS, *(entry for entry in DOCS.rglob("*") if entry.is_dir())):
        assert len([*folder.iterdir()]) <= 12, folder
