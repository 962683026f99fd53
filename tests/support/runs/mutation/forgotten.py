"""Templates that forget a trait of calls: whatever wrong machine comes of it, the proof refuses it by the name of the call."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import Final

import pytest

from pnm.core.machine import generate as generate_module
from pnm.core.machine.call_block import CallBlock, CallKey, RecoveryKey
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import forget_proofs, verify
from tests.support.runs.mutation.machines import as_text, random_machine, written_out

TRAITS: Final = (*CallKey._fields, *RecoveryKey._fields)


@dataclass
class ForgottenReport:
    """What became of the machines without a trait. All fields change."""

    wrong: int = 0
    """How many machines were not those of their plans."""
    refused: int = 0
    """How often one was refused, by blocks and by name."""
    complaints: list[str] = field(default_factory=list)


@contextmanager
def forgetting(trait: str) -> Iterator[None]:
    """Let templates be kept without a trait of their calls."""
    whole = CallBlock.key.fget  # type: ignore[attr-defined]

    def key(block: CallBlock) -> object:
        found = whole(block)
        if trait in RecoveryKey._fields:
            return found._replace(recoveries=tuple(one._replace(**{trait: None}) for one in found.recoveries))
        return found._replace(**{trait: None}) if trait else found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CallBlock, "key", property(key))
        generate_module._TEMPLATES.forget()
        forget_proofs()
        yield
    generate_module._TEMPLATES.forget()
    forget_proofs()


@cache
def alone(number: int) -> list[str]:
    """The machine as it is if no block shares its template."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CallBlock, "key", None)
        return as_text(random_machine(number, under_way=True))


def run_forgotten(trait: str, numbers: range, enough: int | None = None) -> ForgottenReport:
    """Make machines by templates without a trait, until enough are wrong if that is said, and see that all wrong ones are refused.

    Without a trait, `""`, all machines are right, and none is refused.
    """
    report = ForgottenReport()
    with forgetting(trait):
        for number in numbers:
            try:
                machine = random_machine(number, under_way=True)
            except IndexError:  # the template is around steps that the call does not hold
                continue
            is_wrong = as_text(machine) != alone(number)
            report.wrong += is_wrong
            for how, made in (("by blocks", machine), ("by name", written_out(machine))) if is_wrong or not trait else ():
                try:
                    verify(made)
                except Unsound as error:
                    report.refused += 1
                    if not is_wrong:
                        report.complaints.append(f"machine {number} is refused {how}: {error}")
                else:
                    if is_wrong:
                        report.complaints.append(f"machine {number} is proved {how} without {trait}")
            if report.wrong == enough:
                break
    return report
