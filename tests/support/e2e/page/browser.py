"""A browser that looks at pages: one that is on this machine, else one that is brought there."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from playwright.sync_api import Browser, expect, sync_playwright

from tests.support.processes import LIMIT

_NAMES: Final = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_OPTIONS: Final = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run"]
_BRINGS: Final = 900
"""Seconds that it may take to bring a browser to this machine."""


@contextmanager
def browser() -> Iterator[Browser]:
    """Yield a browser without windows."""
    program = _program()
    expect.set_options(timeout=1000 * LIMIT)
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=program, args=_OPTIONS, timeout=1000 * LIMIT)
        try:
            yield opened
        finally:
            opened.close()


def _program() -> str | None:
    """Return a browser of this machine, or None for that of Playwright; one of many test processes brings one if there is none."""
    with (Path(tempfile.gettempdir()) / "pnm-test-browser.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if found := next(filter(None, map(shutil.which, _NAMES)), None):
            return found
        if _succeeds([sys.executable, "-m", "playwright", "install", "chromium-headless-shell"]):
            return None
        if os.geteuid() == 0 and shutil.which("apt-get") and _succeeds(["apt-get", "update"]):
            _succeeds(["apt-get", "install", "-y", "--no-install-recommends", "chromium"])
            if found := shutil.which("chromium"):
                return found
    raise AssertionError(
        f"there is no browser: install one of {', '.join(_NAMES)}, or `python -m playwright install chromium-headless-shell`"
    )


def _succeeds(command: list[str]) -> bool:
    return subprocess.run(command, capture_output=True, timeout=_BRINGS, check=False).returncode == 0
