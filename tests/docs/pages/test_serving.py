"""What docs/guides/serving.md shows of a node is what the node would print."""

from __future__ import annotations

import re

from pnm.language.plan import read_world
from pnm.language.runner import Program
from tests.support.files import ROOT


def test_the_proof_that_is_shown_is_that_of_the_plan() -> None:
    shown = re.search(r"^plan +round_trip: proved (.*)$", (ROOT / "docs/guides/serving.md").read_text(encoding="utf-8"), re.MULTILINE)
    plans = read_world(ROOT / "domains/delivery/plans/world.yaml").plans
    assert shown
    assert shown[1] == str(Program.of(plans["round_trip"]).proof)
