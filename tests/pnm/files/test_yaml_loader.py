"""Files that are no YAML, or not plain data."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given, strategies as st

from pnm.errors import InputError, Position
from pnm.files.text import read_text
from pnm.files.yaml_nodes import MAX_BYTES, MAX_DEPTH, MAX_NODES, load_yaml
from tests.support.files import refused, written
from tests.support.runs.files import error

BAD_INPUT = Path(__file__).with_name("refused")
AT_LIMIT = "a: " + "[" * MAX_DEPTH + "]" * MAX_DEPTH
BAD_YAML = [
    *refused(BAD_INPUT / "plain_data.yaml"),
    ("", "FILE:1:1: the file is empty; expected a mapping"),
    (
        "a: {server: /{robot}/move}",
        "FILE:1:14: not YAML: expected ',' or '}', but got '{'; inside braces and brackets a text with '{' needs quotes",
    ),
    (
        "a: {b: Hello: you}",
        "FILE:1:13: not YAML: expected ',' or '}', but got ':'; inside braces and brackets a text with ':' needs quotes",
    ),
    ("a: 1\nb: {x: 1\n", "FILE:3:1: not YAML: expected ',' or '}', but got '<stream end>'"),
    ("\n  text", "FILE:2:3: expected a mapping (key: value)"),
    ("a: \x07", "FILE:1:1: not YAML: unacceptable character #x0007: special characters are not allowed"),
    ("a: 1" + "0" * 5000, f"FILE:1:4: cannot be read as int: '1{'0' * 39}'"),
    ("a: 0x" + "f" * 5000, f"FILE:1:4: cannot be read as int: '0x{'f' * 38}'"),
    ("a: " + "[" * 2_000, f"FILE:1:1: nested deeper than {MAX_DEPTH}"),
    (b"a: 1\nb: \xff\xfe", "FILE:2:4: not a text file: byte 0xff is not UTF-8"),
    (b"\x7fELF\x00\x00", "FILE:1:1: not a text file: it contains zero bytes"),
]


def plain_entries(path: Path) -> dict[str, object]:
    top = load_yaml(path)
    return {key: top.plain(key) for key in top.nodes}


@pytest.mark.parametrize(("content", "message"), BAD_YAML)
def test_what_is_not_plain_yaml_is_refused(tmp_path: Path, content: str | bytes, message: str) -> None:
    assert error(plain_entries, written(tmp_path, content)) == message


@pytest.mark.parametrize("line", ["a{}: &a{} [{}]\n", "a{}: &a{} {{<<: [{}]}}\n"])
def test_an_alias_bomb_is_refused(tmp_path: Path, line: str) -> None:
    bomb = "a0: &a0 {k: v}\n" + "".join(line.format(n, n, ", ".join([f"*a{n - 1}"] * 9)) for n in range(1, 20))
    assert error(load_yaml, written(tmp_path, bomb)).endswith(f"more than {MAX_NODES} values")


def test_missing_files_folders_and_huge_files_are_refused(tmp_path: Path) -> None:
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    assert error(load_yaml, tmp_path / "nowhere.yaml") == "FILE: there is no such file"
    assert error(load_yaml, tmp_path) == "FILE: this is a folder; expected a file"
    assert error(load_yaml, huge) == f"FILE: the file has more than {MAX_BYTES} bytes; no more are read"
    assert read_text(written(tmp_path, "four"), 4) == "four"
    assert error(lambda path: read_text(path, 3), written(tmp_path, "four")) == "FILE: the file has more than 3 bytes; no more are read"


PLAIN = [
    ("a: 1", 1),
    ("\ufeffa: 0x1F", 31),
    ("a: [1.5, -2, true, TRUE, ~, '1', text]", [1.5, -2, True, True, None, "1", "text"]),
    ("a: {on: on, 1: one, ~: none}", {"on": "on", "1": "one", "~": "none"}),
    ("a: 2024-02-30", "2024-02-30"),
    ("a: [&x {b: c}, *x]", [{"b": "c"}, {"b": "c"}]),
    ("a: |\n  two\n  lines\n", "two\nlines\n"),
    ("a: ''", ""),
    ("a:", None),
    ("a: größer 🤖", "größer 🤖"),
    ("a: [yes, no, on, off, Y, n]", ["yes", "no", "on", "off", "Y", "n"]),
    ("a: [12:30, 1_000, 0b1, 1:1:1]", ["12:30", "1_000", "0b1", "1:1:1"]),
    ("a: [010, 0o17, 0x1F, +3]", [10, 15, 31, 3]),
    ("a: [1e3, -.5, 2., 1E-2]", [1000.0, -0.5, 2.0, 0.01]),
    ("a: [!!bool TRUE, !!str no, !!int '7']", [True, "no", 7]),
]


@pytest.mark.parametrize(("content", "value"), PLAIN, ids=[content for content, _ in PLAIN])
def test_plain_data_is_read_and_keys_stay_text(tmp_path: Path, content: str, value: object) -> None:
    assert plain_entries(written(tmp_path, content)) == {"a": value}


def test_the_deepest_nesting_is_read(tmp_path: Path) -> None:
    assert plain_entries(written(tmp_path, AT_LIMIT)).keys() == {"a"}


@given(st.one_of(st.text("ab: -[]{}&*!'\"|>#%@\n?,~<=0.", max_size=40), st.binary(max_size=40)))
@example("a: !!timestamp x")
@example("a: 0x_")
@example("a: 9:99:99")
def test_anything_is_read_or_refused_with_a_position(tmp_path_factory: pytest.TempPathFactory, content: str | bytes) -> None:
    path = written(tmp_path_factory.getbasetemp(), content)
    try:
        plain_entries(path)
    except InputError as refused:
        position = refused.position
    else:
        position = Position(str(path), 1, 1)
    assert position is not None
    assert position.file == str(path)


def test_pddl_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "domain.pddl").write_text("; robots: they deliver\n\n(define (domain d))\n")
    assert error(load_yaml, tmp_path / "domain.pddl") == "FILE:1:1: this is PDDL; expected YAML"
