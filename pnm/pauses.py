"""Short pauses: what is there when work begins is kept away from the garbage collector, which would look at all of it again and again."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

_SELDOM: Final = 20_000
"""New objects after which garbage is looked for among them, in place of 700."""


@contextmanager
def short_pauses() -> Iterator[None]:
    """Take what has been loaded so far for what stays, and look seldom: a machine is made of thousands of objects, none of them garbage."""
    usual = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(_SELDOM, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)
        gc.unfreeze()
