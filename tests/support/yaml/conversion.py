"""What is compared when PDDL becomes YAML and PDDL again."""

from __future__ import annotations

from planner_bridge.pddl.comments import CommentTable
from planner_bridge.pddl.expressions import tokens


def notes(table: CommentTable) -> list[str]:
    return sorted(one for note in table.values() for one in (*note.before, *note.beside, *note.below) if one)


def comments_in(text: str) -> list[str]:
    return sorted(token.rstrip() for token, _ in tokens(text) if token[0] == ";")
