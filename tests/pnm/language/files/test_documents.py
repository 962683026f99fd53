"""YAML as files of the language have it: merge keys, documents, anchors known beforehand, excerpts."""

from __future__ import annotations

import pytest

from pnm.errors import InputError
from pnm.files.yaml_nodes import MAX_DOCUMENTS, Mapped, parse_yaml
from pnm.language.plan import parse_documents


def only_document(text: str) -> Mapped:
    (found,), warnings = parse_documents(text, "F")
    assert not warnings
    return found


def refusal(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_documents(text, "F")
    return str(caught.value)


def test_merged_keys_give_way_to_own_ones_wherever_they_stand() -> None:
    found = only_document("base: &base {a: 1, b: 2, c: 3}\nmore: &more {c: 4, d: 5}\nall:\n  a: 0\n  <<: [*base, *more]\n  b: 9\n")
    assert found.plain("all") == {"a": 0, "b": 9, "c": 3, "d": 5}


def test_merging_goes_through_merged_mappings() -> None:
    found = only_document("x: &x {instances: [1]}\ny: &y {<<: *x, type: t}\nz: {<<: *y, type: u}\n")
    assert found.plain("z") == {"instances": [1], "type": "u"}


def test_what_is_merged_is_told_where_it_stands() -> None:
    found = only_document("base: &base\n  number: hello\nall:\n  mine:\n    <<: *base\n")
    with pytest.raises(InputError, match=r"F:2:11: expected a number of at least 0 under 'number'"):
        found.section("all").mappings()["mine"].number("number", None)


def test_a_merge_key_in_quotes_is_a_name() -> None:
    assert only_document('"<<": 1').plain("<<") == 1


def test_documents_keep_their_positions() -> None:
    first, second = parse_documents("a: 1\n---\nb: 2\n", "F")[0]
    assert first.plain("a") == 1
    assert (second.start.line, second.position("b").column) == (3, 4)


def test_empty_documents_do_not_count() -> None:
    assert len(parse_documents("---\n---\na: 1\n---\n# nothing\n", "F")[0]) == 1
    assert refusal("---\n---\n") == "F:1:1: the file is empty; expected a mapping"


def test_every_document_is_a_mapping() -> None:
    assert refusal("a: 1\n---\n- b\n") == "F:3:1: expected a mapping (key: value)"


def test_anchors_do_not_reach_into_the_next_document() -> None:
    assert refusal("a: &here 1\n---\nb: *here\n") == "F:3:4: not YAML: found undefined alias 'here'"


def test_kinds_of_actions_have_anchors_that_a_file_may_define_itself() -> None:
    assert only_document("a: {<<: *ros_action}").plain("a") == {"type": "ros_action"}
    assert only_document("a: {<<: *base_action}").plain("a") == {}
    assert only_document("t: &ros_action {type: mine}\na: {<<: *ros_action}").plain("a") == {"type": "mine"}
    assert refusal("a: {<<: *ros_actoin}") == "F:1:9: not YAML: found undefined alias 'ros_actoin'; did you mean 'ros_action'?"


def test_other_files_do_not_have_these_anchors() -> None:
    with pytest.raises(InputError, match="undefined alias"):
        parse_yaml("a: {<<: *ros_action}", "F")


# --- excerpts as they are printed ----------------------------------------------------------

EXCERPT = """\
...
actions:
 first:
  effects:
   and:
    - one: 1
    - not:
     two: 2
     three:
      - 4
    - five: 5
 second:
...
"""


def test_an_excerpt_is_read_as_it_was_meant() -> None:
    (found,), warnings = parse_documents(EXCERPT, "F")
    assert found.plain("actions") == {
        "first": {"effects": {"and": [{"one": 1}, {"not": {"two": 2, "three": [4]}}, {"five": 5}]}},
        "second": None,
    }
    assert [str(one) for one in warnings] == [
        "F:1:1: warning: '...' at the beginning is left out",
        "F:8:1: warning: indented less than its owner in line 7",
    ]


def test_nothing_is_mended_in_what_can_be_read() -> None:
    text = "text: |\n  - not:\n   two\nlist:\n- a:\n    b\n"
    (found,), warnings = parse_documents(text, "F")
    assert found.plain("text") == "- not:\n two\n"
    assert not warnings


def test_what_cannot_be_mended_is_told_as_it_stands() -> None:
    assert refusal("...\na: [1\n") == "F:1:1: not YAML: expected the node content, but found '<document end>'"
    assert refusal("a:\n  - b:\n   c: 1\n d: }\n").startswith("F:3:4: not YAML")


def test_a_file_is_not_read_further_than_its_values_may_be_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pnm.files.yaml_nodes.MAX_NODES", 10)
    assert refusal("a: [" + "1, " * 20 + "}").endswith("not YAML: more than 10 values")


def test_documents_are_counted() -> None:
    assert refusal("---\na: 1\n" * (MAX_DOCUMENTS + 1)).endswith(f"not YAML: more than {MAX_DOCUMENTS} documents")
    assert len(parse_documents("---\na: 1\n" * MAX_DOCUMENTS, "F")[0]) == MAX_DOCUMENTS
