"""Tests of journals that are coroutines run on virtual time."""

from __future__ import annotations

from inspect import iscoroutinefunction, signature

import pytest

from pnm.clock import run_async


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine."""
    if not iscoroutinefunction(pyfuncitem.obj):
        return None
    run_async(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in signature(pyfuncitem.obj).parameters}), virtual=True)
    return True
