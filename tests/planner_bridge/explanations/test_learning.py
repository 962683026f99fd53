"""Rates from journals: every attempt counts once, whatever is read when."""

from __future__ import annotations

import re
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from uuid import uuid4

import pytest
from click.testing import CliRunner

from planner_bridge.cli.commands import app
from planner_bridge.explanations.history import JournalHistory
from planner_bridge.explanations.learning import learn
from planner_bridge.model.rates import GONE, MOST_GONE, NO_RATES, Call, Counts, End, Rates, read_rates, update_rates
from planner_bridge.node.spare_time import Learner
from planner_bridge.pddl import read_domain
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.pipeline.loading import rates_for
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.errors import InputError
from pnm.files.database.place import Place
from pnm.journal.kept import JournalChoice
from pnm.journal.store import copy_journal
from pnm.tasks import Code, TaskEnding
from tests.support.files import ROOT, written
from tests.support.runs.simulated import on_a_loop
from tests.support.tasks.scenarios.random_scenarios import run_scenario

DELIVERY = ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl"


def ends_of(rates: Rates) -> Counter[End]:
    return sum((Counter(counts.ends) for counts in rates.calls.values()), Counter())


def run_with(kind: FaultKind, journal: JournalChoice | Path, what: str = "move", times: int = 1, **more: object) -> Rates:
    assert achieve(*DELIVERY, faults=Faults((Fault(what, kind, times=times, **more),)), journal=journal).goal_reached  # type: ignore[arg-type]
    return learn(journal if isinstance(journal, Path) else journal.place)


def test_every_attempt_counts_once(delivery: Path) -> None:
    history, rates = JournalHistory.read(delivery), learn(delivery)
    sent = [attempt for attempt in history.attempts.values() if attempt.action.operation is None and attempt.ended is not None]
    assert ends_of(rates) == Counter(End(attempt.outcome.kind.value) for attempt in sent if attempt.outcome)
    assert ends_of(rates)[End.ABORTED] > 1
    taken = sum(attempt.ended - attempt.accepted for attempt in sent if attempt.ended is not None and attempt.accepted is not None)
    milliseconds = sum(counts.took.total + counts.failed_after.total for counts in rates.calls.values())
    assert milliseconds / 1000.0 == pytest.approx(taken, abs=0.001 * len(sent))


@pytest.mark.parametrize("number", [6, 9, 12, 29])  # lost and never found; handed over; without effects; timed out
def test_no_attempt_is_left_out_whatever_happens(number: int, tmp_path: Path) -> None:
    run_scenario(number, journal=tmp_path / "journal")
    attempts = JournalHistory.read(tmp_path / "journal").attempts.values()
    ended = sum(attempt.action.operation is None and attempt.ended is not None for attempt in attempts)
    assert ends_of(learn(tmp_path / "journal")).total() == ended > 2


@pytest.mark.parametrize(
    ("kind", "end"),
    [
        (FaultKind.ABORT, End.ABORTED),
        (FaultKind.REJECT, End.REJECTED),
        (FaultKind.HANG, End.TIMED_OUT),
        (FaultKind.NO_EFFECT, End.EFFECTS_MISSING),
    ],
)
def test_an_attempt_ends_as_the_run_has_seen_it(tmp_path: Path, kind: FaultKind, end: End) -> None:
    counted = ends_of(run_with(kind, tmp_path / "j"))
    assert counted[end] == 1
    assert counted.keys() == {end, End.SUCCEEDED}


def test_journals_add_up_and_none_counts_twice(tmp_path: Path) -> None:
    one, other = (tmp_path / name for name in ("one", "other"))
    first, second = run_with(FaultKind.ABORT, one), run_with(FaultKind.REJECT, other)
    both = learn(other, learn(one))
    assert first.merge(second) == learn(one, learn(other)) == both
    assert len(both.journals) == 2
    assert learn(one, learn(other, both)) == both.merge(first) == both


def test_a_journal_that_has_grown_adds_what_is_new(place: Place) -> None:
    journal = JournalChoice(place)
    before = run_with(FaultKind.ABORT, journal)
    after = run_with(FaultKind.REJECT, journal)
    assert ends_of(after)[End.REJECTED] == ends_of(after)[End.ABORTED] == 1
    assert learn(place, before) == after
    assert [*before.journals] == [*after.journals], "it is the same one"
    assert before.merge(after) == after


def test_a_journal_that_has_grown_is_read_from_where_it_was_read_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rates, applied, apply = NO_RATES, list[int](), JournalHistory.apply
    monkeypatch.setattr(JournalHistory, "apply", lambda history, number, *more: applied.append(number) or apply(history, number, *more))
    for _ in range(3):
        run_with(FaultKind.ABORT, tmp_path / "j")
        before, rates = rates, learn(tmp_path / "j", rates)
        applied.clear()
    assert learn(tmp_path / "j", before) == rates == learn(tmp_path / "j")
    last, again = max(before.journals.values()), applied[: applied.index(1)]
    assert 1 < min(again) <= last + 1
    assert again == [*range(min(again), max(again) + 1)]


def test_a_copy_is_the_same_journal(tmp_path: Path) -> None:
    rates = run_with(FaultKind.ABORT, tmp_path / "j")
    copy_journal(tmp_path / "j", tmp_path / "copy")
    assert learn(tmp_path / "copy", rates) == rates == learn(tmp_path / "copy")


def test_chances_of_simulated_faults_are_found_again(tmp_path: Path) -> None:
    rates = NO_RATES
    for number in range(8):
        faults = Faults((Fault("move", FaultKind.ABORT, chance=0.3),), seed=number)
        achieve(*DELIVERY, faults=faults, journal=tmp_path / str(number))
        rates = learn(tmp_path / str(number), rates)
    low, high = rates.chance(Call("", "move")).interval()
    assert low < 0.7 < high
    assert rates.chance(Call("", "move")).rests.n > 30


def test_the_command_adds_to_its_file(tmp_path: Path, delivery: Path) -> None:
    file, other = tmp_path / "rates.yaml", tmp_path / "other.yaml"
    run_with(FaultKind.ABORT, tmp_path / "j")
    for given in ([str(delivery)], [str(delivery)], [str(tmp_path / "j")]):
        result = CliRunner().invoke(app, ["learn", *given, "-o", str(file)])
        assert result.exit_code == 0, result.output
    assert read_rates(file) == learn(tmp_path / "j", learn(delivery))
    assert CliRunner().invoke(app, ["learn", str(file), "-o", str(other)]).exit_code == 0
    assert other.read_text() == file.read_text()
    assert "not a database" in CliRunner().invoke(app, ["learn", str(DELIVERY[0])]).output


def test_runs_learn_as_they_end(tmp_path: Path) -> None:
    for file in DELIVERY:
        (tmp_path / file.name).write_bytes(file.read_bytes())
    domain, problem = (str(tmp_path / file.name) for file in DELIVERY)
    for number in (1, 2):
        assert CliRunner().invoke(app, ["run", domain, problem, "--learn", "-q"]).exit_code == 0
        rates = rates_for(tmp_path / "domain.pddl", None)
        assert rates
        assert len(rates.journals) == number, "each run has had a journal"
        assert {id[: len(GONE)] for id in rates.journals} == {GONE}, "which is no more"
    assert ends_of(rates) == {End.SUCCEEDED: 16}
    elsewhere = tmp_path / "elsewhere.yaml"
    assert CliRunner().invoke(app, ["run", domain, problem, "--learn", "--rates", str(elsewhere), "-q"]).exit_code == 0
    learned = rates_for(None, elsewhere)
    assert learned
    assert ends_of(learned) == {End.SUCCEEDED: 8}
    assert rates_for(tmp_path / "domain.pddl", None) == rates


def test_a_file_does_not_grow_with_journals_that_are_no_more(tmp_path: Path) -> None:
    rates, attempt = NO_RATES.grown("kept", 7, ()), (Call("go", "go"), Counts.of(End.LOST, 1.0))
    for _ in range(2 * MOST_GONE):
        rates = rates.grown(f"{GONE}{uuid4()}", 1, [attempt])
    assert len(rates.journals) == MOST_GONE + 1
    assert rates.journals["kept"] == 7
    assert read_rates(written(tmp_path / "rates.yaml", rates.text())) == rates
    assert ends_of(rates)[End.LOST] == 2 * MOST_GONE


def test_plans_are_measured_by_the_rates_beside_the_domain(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("domain.pddl", "problem1.pddl")]
    for file in files:
        file.write_bytes((ROOT / "domains" / "household" / file.name).read_bytes())
    command = ["plan", *map(str, files), "--improve", "0"]
    assert "expected" not in CliRunner().invoke(app, command).output
    elsewhere = tmp_path / "elsewhere.yaml"
    for file, seconds in ((tmp_path / "rates.yaml", 6), (elsewhere, 600)):
        file.write_text(f"servers: {{s: {{'navigate(robot)': {{ends: {{succeeded: 9}}, took: {9 * seconds} = 9*{seconds}}}}}}}")
    short, long = (CliRunner().invoke(app, [*command, *more]).output for more in ([], ["--rates", str(elsewhere)]))
    found = [re.search(r"([\d.]+) s expected", output) for output in (short, long)]
    assert [match is not None and float(match[1]) > 100 for match in found] == [False, True]
    assert "there is no such file" in CliRunner().invoke(app, [*command, "--rates", str(tmp_path / "none.yaml")]).output


@on_a_loop
async def test_a_node_learns_when_a_task_is_over(delivery: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.mktemp("node") / "rates.yaml"
    learner = Learner(delivery, file)
    assert not file.exists()
    learner.ended(uuid4(), TaskEnding(Code.GOAL_REACHED, ""))
    await learner.close()
    assert read_rates(file) == learn(delivery)
    spoiled = Learner(file, file)  # which is no journal
    spoiled.ended(uuid4(), TaskEnding(Code.GOAL_REACHED, ""))
    await spoiled.close()
    assert read_rates(file) == learn(delivery)


def test_processes_that_learn_at_once_lose_nothing(tmp_path: Path) -> None:
    def more(rates: Rates) -> Rates:
        return rates.grown(str(len(rates.journals)), 1, [(Call("s", "move"), Counts.of(End.SUCCEEDED, 1.0))])

    with ThreadPoolExecutor(4) as threads:
        for done in [threads.submit(update_rates, tmp_path / "rates.yaml", more) for _ in range(20)]:
            done.result()
    assert read_rates(tmp_path / "rates.yaml").calls[Call("s", "move")].ends == {End.SUCCEEDED: 20}
    assert [file.name for file in tmp_path.iterdir()] == ["rates.yaml"]
    with pytest.raises(InputError, match="cannot be written: No such file or directory"):
        update_rates(tmp_path / "nowhere" / "rates.yaml", more)


def test_limits_that_fit_are_those_of_calls_if_that_is_wanted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for file in DELIVERY:
        (tmp_path / file.name).write_bytes(file.read_bytes())
    times = sum((Counts.of(End.SUCCEEDED, 3.9 + number / 100) for number in range(20)), Counts())
    rates = NO_RATES.grown("j", 1, [(Call(action, action), times) for action in ("open_door", "load")])
    written(tmp_path / "rates.yaml", rates.text())
    written(tmp_path / "faults.yaml", "faults: [{action: load, do: hang, times: 1}]\n")
    command = ["run", *(str(tmp_path / file.name) for file in DELIVERY), "--faults", str(tmp_path / "faults.yaml")]
    limit = rates.limit(Call("", "load"))
    assert limit is not None
    for more, seconds in (((), 10.0), (("--learned-limits",), limit)):
        assert CliRunner().invoke(app, [*command, *more]).exit_code == 0
        assert f"load(r1, parcel2, store): it has not ended within {seconds:g} s" in caplog.text
        caplog.clear()
    bound = rates.limiting(Bindings({"load": Binding(timeout=7.0)}), read_domain(DELIVERY[0]).actions)
    assert (bound.of("load").timeout, bound.of("move").timeout) == (7.0, None)
    assert bound.of("open_door").timeout == limit
