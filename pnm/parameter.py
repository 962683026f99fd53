"""Parameters of a program, as command lines, launch files and parameter services give and show them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

ParameterValue: TypeAlias = bool | int | float | str


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter; its type is that of its default.

    Args:
        name: as ROS 2 has it; the option of a command line has ``-`` for ``_``.
        default: an empty text stands for nothing.
        description: for people.
        least: the smallest number that makes sense.
        choices: the texts that make sense, when not all do.
        option: the name of the option, when it is another one.
    """

    name: str
    default: ParameterValue
    description: str
    least: float = 0
    choices: tuple[str, ...] = ()
    option: str = ""
