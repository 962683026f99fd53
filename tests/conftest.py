"""Where things are, and plans to try things on."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.support.files import ROOT

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # we are in the background of a shell: our children are not to ignore it as well
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def root() -> Path:
    return ROOT


@pytest.fixture(autouse=True)
def own_state(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep tests, and the processes they start, away from the knowledge of whoever runs them."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.getbasetemp() / "state"))
