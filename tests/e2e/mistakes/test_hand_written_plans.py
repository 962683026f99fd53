"""Mistakes in plans by hand, as far as they are not in the tables of their reader (`tests/pnm/language/refused`)."""

from __future__ import annotations

from pathlib import Path

from tests.support.e2e.command_line import Mistake, mistakes, pnm

HEAD = """\
actions:
  go: {params: [place]}
  say: {params: [text]}
  stop: {params: []}
initial_knowledge: {name: Ada, served: 0}
plan:
"""
FEW = "{Comparison: [lt, [LocalQuery: served, 2]]}"


def steps(text: str, *says: str, status: int = 2) -> Mistake:
    return Mistake("run --plan plan.yaml", status, says, {"plan.yaml": f"{HEAD}{text}\n"})


MISTAKES = {
    "a value without its parameter": steps(
        "  - go: hall", "plan.yaml:7:9: expected the parameters of go, found 'hall'; write '- go: {place: hall}'"
    ),
    "a value for nothing": steps("  - stop: hall", "7:11: expected the parameters of stop, found 'hall'; write '- stop:'"),
    "a list for the parameters": steps("  - go: [hall]", "7:9: expected the parameters of go, found a list; write '- go: {place: …}'"),
    "no colon": steps("  - stop", "7:5: expected a step such as '- action: {parameter: value}', found 'stop'; write '- stop:'"),
    "no colon before braces": steps("  - go {place: hall}", "7:5: expected ': ' after 'go', found 'go {place'"),
    "no space before braces": steps("  - go:{place: hall}", "7:5: expected ': ' after 'go', found 'go:{place'"),
    "no space behind the dash": steps(
        "  -go: {place: hall}", "7:3: expected a list of steps, found a mapping; each begins with a dash and a space"
    ),
    "no dash": steps("  go: {place: hall}", "7:3: expected a list of steps, found a mapping; each begins with a dash and a space"),
    "a parameter is misspelt": steps("  - go: {plase: hall}", "7:10: go has no parameter 'plase'; did you mean 'place'?"),
    "a parameter too many": steps("  - go: {place: hall, speed: 3}", "7:23: go has no parameter 'speed'; expected one of: place"),
    "no value for a parameter": steps("  - go:", "failed go(?place): data_missing: expected values for place", status=1),
    "an action is misspelt": steps("  - sai: {text: Hello}", "7:5: there is no action 'sai' here; did you mean 'say'?"),
    "a block is misspelt": steps(
        "  - concurent_actions: [stop: ]", "7:5: there is no action 'concurent_actions' here; did you mean 'concurrent_actions'?"
    ),
    "an option is misspelt": steps(
        "  - stop:\n    retrys: 3", "8:5: a step does one thing; 'retrys' is a second one, and none of the options: id, "
    ),
    "words for a number": steps("  - stop:\n    retries: three", "8:14: expected a number of at least 0 under 'retries', found 'three'"),
    "a condition beside its loop": steps(
        f"  - while:\n    condition: {FEW}\n    actions: [stop: ]", "8:5: 'condition' belongs under 'while': two more spaces before it"
    ),
    "actions beside their loop": steps(
        f"  - while:\n      condition: {FEW}\n    actions: [stop: ]", "9:5: 'actions' belongs under 'while': two more spaces before it"
    ),
    "a condition under a choice": steps(
        f"  - if:\n      condition: {FEW}\n    then: [stop: ]", "8:7: 'condition' does not belong under 'if': 'if' has the condition itself"
    ),
    "the way under a choice": steps(
        "  - if:\n      then: [stop: ]\n      Comparison: [lt, [1, 2]]", "8:7: 'then' does not belong under 'if': it stands beside 'if'"
    ),
    "a choice without a way": steps(f"  - if: {FEW}\n  - stop:", "7:5: the key 'then' is missing"),
    "a condition in words": steps(
        "  - while: {condition: served < 2, actions: [stop: ]}", "7:24: expected a condition, such as", "found 'served < 2'"
    ),
    "a colon in a text": steps(
        "  - say: Hello: how are you",
        "7:15: not YAML: mapping values are not allowed here; a text with ': ' in it needs quotes, unless the line above lacks its colon",
    ),
    "a colon in a text in braces": steps("  - say: {text: Hello: how are you}", "7:22: not YAML", "a text with ':' needs quotes"),
    "a sign that texts cannot begin with": steps("  - say: {text: @home}", "7:17: not YAML", "a text that begins with it needs quotes"),
    "a tab": steps("\t- stop:", "7:1: not YAML", "indent with spaces, not with tabs"),
    "a step that is indented otherwise": steps(
        "  - go: {place: hall}\n   - stop:", "8:4: not YAML", "its indentation differs from that of its neighbours"
    ),
    "a key without its colon": Mistake(
        "run --plan p.yaml", 2, ("p.yaml:2:5: not YAML", "unless the line above lacks its colon"), {"p.yaml": "actions\nplan: []\n"}
    ),
    "a variable as other languages write it": steps(
        '  - say: {text: "Hello ${name}"}',
        "start  say(Hello ${name})",
        "plan.yaml:7:17: warning: '${name}' stays as it is written; ",
        "for the value of name write {Operation: [concat, [..., {LocalQuery: name}]]}",
        status=0,
    ),
    "a variable in braces": steps('  - say: {text: "Hello {name}"}', "warning: '{name}' stays as it is written", status=0),
    "a variable as bindings write it": steps(
        "  - say: {text: $name}", "warning: '$name' stays as it is written; for the value of name write {LocalQuery: name}", status=0
    ),
    "a key of plans is misspelt": Mistake(
        "run --plan p.yaml", 2, ("p.yaml:2:1: unknown key 'plam'; did you mean 'plan'?",), {"p.yaml": "actions: {stop: }\nplam: [stop: ]\n"}
    ),
    "a key that no plan has": Mistake(
        "run --plan p.yaml",
        2,
        ("p.yaml:2:1: unknown key 'x'; expected one of plan, domain, params", ", …"),
        {"p.yaml": "actions: {stop: }\nx: 3\n"},
    ),
}


@mistakes(MISTAKES)
def test_a_mistake_in_a_plan_by_hand(mistake: Mistake, tmp_path: Path) -> None:
    mistake.check(tmp_path)


def test_a_text_like_a_variable_is_warned_about_also_when_the_machine_is_written(tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text(HEAD + '  - say: {text: "Hello ${name}"}\n')
    done = pnm("net", "--plan", "plan.yaml", cwd=tmp_path)
    assert (done.returncode, "warning: '${name}' stays as it is written" in done.stderr) == (0, True)


ASKED = """\
actions: {bring: {params: [drink]}}
plan:
  - bring: {drink: {PersonQuery: first}}
  - while:
      condition: {Comparison: [ne, [{PersonQuery: next}, nothing]]}
      actions:
        - bring: {drink: {PersonQuery: first}}
"""


def test_people_who_are_not_there_are_answered_for(tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text(ASKED)
    answers = ("first=tea", "next=1", "next=[2]", "next=nothing", "nxt=3")
    done = pnm("run", "--plan", "plan.yaml", *(word for answer in answers for word in ("--answer", answer)), cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.count("start  bring(tea)") == 3
    assert done.stderr == "the answer to nxt was not needed\n"
