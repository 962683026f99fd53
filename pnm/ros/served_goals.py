"""A goal for a plan: what comes in with it, and what goes out at its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pnm.errors import InputError
from pnm.sources.base import SourceError
from pnm.sources.people import printable
from pnm.sources.values import read_value, write_value
from pnm.yaml_files import parse_value


@dataclass(frozen=True, slots=True)
class Ending:
    """How a goal ended: the fields of its result."""

    success: bool
    reason: str
    """A word for programs, as the interface lists them."""
    message: str
    results: Mapping[str, object] = field(default_factory=dict)

    def fields(self) -> dict[str, object]:
        """Return the fields of the result as a message has them; values that JSON cannot say are told of in its message."""
        written: dict[str, str] = {}
        unsaid = ""
        for name, value in self.results.items():
            try:
                written[name] = f"{write_value(name)}: {write_value(value)}"
            except SourceError as error:
                unsaid += f"; {name} is left out: {error}"
        results = f"{{{', '.join(written.values())}}}"
        return {"success": self.success, "reason": self.reason, "message": printable(self.message + unsaid), "results": results}


def read_parameters(text: str) -> dict[str, object]:
    """Read what a goal says about the parameters of its plan: a mapping as YAML or JSON, or nothing.

    Raises:
        InputError: it is something else.
    """
    try:
        found = read_value(text)  # JSON first: not all of it means the same in YAML, such as 1e3 and escaped emoji
    except SourceError:
        found = parse_value(text, "parameters") if text.strip() else {}
    if not isinstance(found, dict):
        raise InputError(f"expected a mapping such as {{shop: bakery}} as parameters, found {text.strip()[:40]!r}")
    return found
