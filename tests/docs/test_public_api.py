"""What is public is listed; a change of the lists is a change of the contract."""

from __future__ import annotations

from pathlib import Path

import pytest

import planner_bridge
import pnm
from tests.support.files import ROOT


def test_every_public_name_is_there_and_documented() -> None:
    for package in (pnm, planner_bridge):
        for name in package.__all__:
            assert getattr(package, name) is not None
            if callable(getattr(package, name)):
                assert getattr(package, name).__doc__, name


def test_the_lists_are_sorted_and_complete() -> None:
    for package in (pnm, planner_bridge):
        assert list(package.__all__) == sorted(package.__all__, key=lambda name: (not name.isupper(), name[0].islower(), name))
        assert dir(package) == sorted(package.__all__)


def test_what_people_print_is_short() -> None:
    problem = planner_bridge.load(ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl")
    result = planner_bridge.achieve(None, problem)
    for value in (problem, problem.domain, result, result.episodes[0].result, result.episodes[0].machine):
        assert len(repr(value)) < 200, repr(value)


def test_the_packages_say_that_they_have_types() -> None:
    for package in (pnm, planner_bridge):
        assert (Path(package.__path__[0]) / "py.typed").is_file()


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'spam'"):
        pnm.spam  # noqa: B018


def test_no_module_hides_a_public_name() -> None:
    for package in (pnm, planner_bridge):
        folder = Path(package.__path__[0])
        assert not {path.stem for path in folder.iterdir()} & set(package.__all__)
