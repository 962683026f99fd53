"""What is public is listed; a change of the lists is a change of the contract."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

import planner_bridge
import pnm
from tests.support.files import ROOT


@pytest.mark.parametrize("package", [pnm, planner_bridge])
def test_every_public_name_is_listed_documented_and_hidden_by_no_module(package: ModuleType) -> None:
    names = list(package.__all__)
    assert names == sorted(names, key=lambda name: (not name.isupper(), name[0].islower(), name))
    assert dir(package) == sorted(names)
    assert not [name for name in names if callable(getattr(package, name)) and not getattr(package, name).__doc__]
    files = {path.name for path in Path(package.__path__[0]).iterdir()}
    assert not {name.removesuffix(".py") for name in files} & set(names)
    assert "py.typed" in files, "it has types"
    with pytest.raises(AttributeError, match="has no attribute 'spam'"):
        package.spam  # noqa: B018


def test_what_people_print_is_short() -> None:
    problem = planner_bridge.load(ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl")
    result = planner_bridge.achieve(None, problem)
    for value in (problem, problem.domain, result, result.episodes[0].result, result.episodes[0].machine):
        assert len(repr(value)) < 200, repr(value)
