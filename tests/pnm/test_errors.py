"""Tests of the words of errors."""

from __future__ import annotations

import importlib.metadata
import json

import pytest

from pnm.errors import installation

BY_NAME = "pip install 'petri-net-machines[view]'"


@pytest.mark.parametrize(
    ("origin", "command"),
    [
        ({"url": "file:///a%20b/c", "dir_info": {"editable": True}}, "pip install -e '/a b/c[view]'"),
        ({"url": "file:///c", "dir_info": {}}, "pip install '/c[view]'"),
        ({"url": "file:///c.whl", "archive_info": {}}, BY_NAME),
        (None, BY_NAME),
    ],
)
def test_an_extra_is_installed_from_where_this_was(monkeypatch, origin, command):
    class Installed:
        def read_text(self, name):
            return origin and json.dumps(origin)

    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: Installed())
    assert installation("view") == command


def test_an_extra_is_installed_by_name_where_this_was_not_installed(monkeypatch):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    assert installation("view") == BY_NAME
