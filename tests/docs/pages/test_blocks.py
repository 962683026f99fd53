"""What a page shows is compared with what is printed, and rewritten by it: ellipses stand for any lines."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from tests.support.docs.page import LEFT_OUT, Step, as_it_is, blocks_of, follow

PRINTED = "plan     2 calls\nstart  a\ndone   a\nstart  b\ndone   b\ngoal     holds\n"
LINES = st.lists(st.sampled_from(["start  a\n", "start  b\n", "done   a\n", "goal     holds\n", "\n"]), max_size=8)


class Echo:
    """A shell that prints what its commands say."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def printed(self, step: Step) -> str:
        return step.command.removeprefix("echo ") + "\n"


@pytest.mark.parametrize(
    ("shown", "agrees"),
    [
        (PRINTED, True),
        ("…\n", True),
        ("plan     2 calls\n…\ngoal     holds\n", True),
        ("…\nstart  a\n…\ndone   b\n…\n", True),
        ("…\ndone   b\n…\nstart  a\n…\n", False),
        ("plan     2 calls\ngoal     holds\n", False),
        ("plan     3 calls\n…\n", False),
        ("…\ngoal\n", False),
    ],
)
def test_an_ellipsis_stands_for_any_lines_and_nothing_else_does(shown: str, agrees: bool) -> None:
    assert Step("pnm run", shown).agrees(PRINTED) is agrees


def test_only_in_terminals_times_and_ids_may_differ() -> None:
    shown, printed = "      0.10 s  ab67ff4e  sent\n", "      0.32 s  00112233  sent\n"
    assert Step("pnm watch", shown, "terminal 1").agrees(printed)
    assert not Step("pnm watch", shown).agrees(printed)


@given(LINES, st.lists(LINES, min_size=1, max_size=4))
def test_what_is_written_agrees_with_what_was_printed(printed: list[str], shown: list[list[str]]) -> None:
    real, output = "".join(printed), LEFT_OUT.join("".join(part) for part in shown)
    written = Step("pnm run", output).as_printed(real).removeprefix("$ pnm run\n")
    assert Step("pnm run", written).agrees(real)
    assert LEFT_OUT not in output or LEFT_OUT in written, "what is left out stays left out"


def test_a_page_is_rewritten_where_it_differs_and_nowhere_else(tmp_path: Path) -> None:
    page = "Text.\n\n```console\n$ echo one\none\n$ echo two\n2\n```\n\n```console not run\n$ echo three\n3\n```\n"
    page += "\n```yaml a.yaml\nb: 1\n```\n"
    assert as_it_is(page, follow(page, Echo(tmp_path))) == page.replace("\n2\n", "\ntwo\n")
    assert (tmp_path / "a.yaml").read_text() == "b: 1\n"
    assert [block.name for block in blocks_of(page)] == ["", "not run", "a.yaml"]
