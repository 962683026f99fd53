"""Files of others, where their folder is present beside the project."""

from __future__ import annotations

from pathlib import Path

import kairos
import pytest

from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.writer import write_domain, write_problem
from pnm.errors import InputError
from tests.support.pddl.files import REFUSED, pairs
from tests.support.pddl.text import SMALL


@pytest.mark.parametrize("folder", [folder for folder in pairs() if folder.name in REFUSED], ids=lambda folder: folder.name)
def test_pairs_that_are_refused(folder: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_problem(folder / "problem.pddl", read_domain(folder / "domain.pddl"))
    assert str(caught.value) == f"{folder}/{REFUSED[folder.name]}"


@pytest.mark.parametrize("folder", [folder for folder in pairs() if folder.name not in REFUSED], ids=lambda folder: folder.name)
def test_pairs_are_read_and_written(folder: Path) -> None:
    domain = read_domain(folder / "domain.pddl")
    problem = read_problem(folder / "problem.pddl", domain)
    written = write_domain(domain), write_problem(problem)
    kairos.parse_problem(written[1], kairos.parse_domain(written[0]))
    again = parse_domain(written[0])
    assert again == domain
    assert parse_problem(written[1], again) == problem


def test_large_files_are_read() -> None:
    facts = "\n".join(f"(at r{index} room{index % 50})" for index in range(20_000))
    robots = " ".join(f"r{index}" for index in range(20_000))
    rooms = " ".join(f"room{index}" for index in range(50))
    text = f"{SMALL.problem} (:objects {robots} - robot {rooms} - room) (:init {facts}) (:goal ()))"
    domain = SMALL.domain_with("")
    problem = parse_problem(text, domain)
    assert len(problem.init) == 20_000
