"""The examples of the page about Python are programs that run."""

from __future__ import annotations

import pytest

from tests.support.docs.page import DOCS, Block, blocks_of
from tests.support.files import ROOT


def is_output(block: Block | None) -> bool:
    return block is not None and block.kind == "output"  # what it prints is compared as that of all pages is


BLOCKS = blocks_of((DOCS / "guides" / "python.md").read_text(encoding="utf-8"), "python", "output")
FOLLOWED = zip(BLOCKS, [*BLOCKS[1:], None], strict=True)
EXAMPLES = [block.body for block, following in FOLLOWED if block.kind == "python" and not is_output(following)]
PRINTED = [
    ["True the goal holds", "load(r1, parcel2, store) succeeded 1"],
    ["PAUSED", "cancelled"],
    ["7 arrows", "digraph plan {", "127 places"],
    ["r1 load(r1, parcel2, store) 0.0 [0.0]", "8 bars of what was done"],
    ["(127, 345) begin", "begin < load(r1, parcel2, store)#0\n", "load → move"],
    ["switches switch_on ('hall',)", "True 2"],
    ["plan of", "attempt 1"],
]


@pytest.mark.parametrize(("program", "printed"), list(zip(EXAMPLES, PRINTED, strict=True)))
def test_an_example_of_the_page_runs(
    program: str, printed: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    exec(program, {"__name__": "__main__"})
    out, err = capsys.readouterr()
    assert err == ""
    for text in printed:
        assert text in out
