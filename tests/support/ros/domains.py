"""ROS domains for tests, each locked against every other test on the same machine."""

from __future__ import annotations

import fcntl
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def ros_domain() -> Iterator[int]:
    """Yield a number that nobody else has who asks here; the lock ends with the process at the latest."""
    for number in range(101, 0, -1):
        file = (Path(tempfile.gettempdir()) / f"pnm-test-domain-{number}").open("w")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            continue
        with file:
            yield number
        return
    raise RuntimeError("all ROS domains are in use by tests")
