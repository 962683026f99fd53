"""The help of every command: short descriptions that are not cut off, examples that are right, and the same names everywhere."""

from __future__ import annotations

import re
import shlex

import click
import pytest
from click.testing import CliRunner

from planner_bridge.cli.commands import app

CONTEXT = click.Context(app, info_name="pnm")
COMMANDS = {name: command for name in app.list_commands(CONTEXT) if (command := app.get_command(CONTEXT, name))}


def shown(*arguments: str) -> str:
    done = CliRunner().invoke(app, arguments, prog_name="pnm")
    assert done.exit_code == 0
    return done.output


def test_no_description_is_cut_off() -> None:
    lines = shown("--help").partition("Commands:\n")[2].splitlines()
    assert [line.split()[0] for line in lines] == [*COMMANDS]
    for line in lines:
        description = line.split(maxsplit=1)[1]
        assert description.endswith(".")
        assert not description.endswith("...")
        assert len(description) <= 50, line


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_has_an_example_whose_words_the_command_takes(name: str) -> None:
    text = " ".join(shown("help", name).split())
    assert text == " ".join(shown(name, "--help").split())
    examples = text.partition("Example")[2].lstrip("s: ").split("; ")
    for example in examples:
        program, command, *arguments = shlex.split(example)
        assert (program, command) == ("pnm", name)
        COMMANDS[name].make_context(name, arguments, resilient_parsing=False)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_limit_of_the_planner_has_one_name(name: str) -> None:
    options = {option for parameter in COMMANDS[name].params for option in parameter.opts}
    assert "--timeout" not in options
    assert ("--planner-timeout" in options) is ("--planner" in options)
    assert all(re.fullmatch(r"-[a-z]|--[a-z-]+|[a-z_]+", option) for option in options)
