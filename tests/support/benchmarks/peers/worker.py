"""A worker of the benchmark: measures what it is asked for, over its standard input and output, in a process and an environment of its own.

A question is a line with the name of a measure and a size, the answer a line of JSON: `value`, or `missing` with what is not installed,
or `error`. Uses the standard library alone: the peers run where nothing of this project is installed.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from collections.abc import Callable, Mapping

Measure = Callable[[int], float]
"""Returns microseconds for each of so many calls, firings or other items."""


class NotHere(Exception):
    """What is to be measured cannot run here; says why."""


def each(work: Callable[[], object], count: int) -> float:
    """Return the microseconds of the processor that some work takes, for each of so many items; waiting does not count."""
    gc.collect()
    began = time.process_time()
    work()
    return (time.process_time() - began) / count * 1e6


def known(count: int) -> dict[str, bool]:
    """Return what calls check that clean a kitchen, each by a robot of its own."""
    return {"free kitchen": True, **{f"ready r{number}": True for number in range(count)}}


def each_done(work: Callable[[], object], count: int, known: dict[str, bool]) -> float:
    """Measure as `each` does; every robot must be done."""
    took = each(work, count)
    assert sum(name.startswith("done") for name in known) == count
    return took


def answer(measures: Mapping[str, Measure], name: str, size: int) -> dict[str, object]:
    """Return the answer to one question."""
    try:
        return {"value": measures[name](size)}
    except ModuleNotFoundError as error:
        return {"missing": f"{error.name} is not installed"}
    except NotHere as error:
        return {"missing": str(error)}
    except Exception as error:  # a peer may raise whatever it likes: the other rows are measured all the same
        return {"error": f"{type(error).__name__}: {error}".splitlines()[0]}


def serve(measures: Mapping[str, Measure]) -> None:
    """Answer questions until there are no more; what peers print goes to the standard error."""
    out, sys.stdout = sys.stdout, sys.stderr
    for line in sys.stdin:
        name, size = line.split()
        print(json.dumps(answer(measures, name, int(size))), file=out, flush=True)
