"""Answers of the page in JSON, whose texts are printable: they may come from any file, server or node."""

from __future__ import annotations

import json
from typing import Any

from starlette.responses import JSONResponse

from pnm.errors import printable


def shown_json(value: object) -> str:
    """Return a value as JSON on one line, in whose texts nothing controls anything or turns the order of letters around."""
    return printable(json.dumps(value, ensure_ascii=False, allow_nan=False))


class ShownResponse(JSONResponse):
    """An answer to a browser."""

    def render(self, content: Any) -> bytes:
        """Return the answer as it is sent."""
        return shown_json(content).encode()
