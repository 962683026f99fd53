"""The YAML that the README shows is what the readers read."""

from __future__ import annotations

import re
from pathlib import Path

from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import read_faults
from pnm.language import read_plans
from tests.support.files import ROOT

SHOWN = re.findall(r"```yaml\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)


def test_the_yaml_of_the_readme_is_read(tmp_path: Path) -> None:
    bindings, faults, plan = SHOWN
    (tmp_path / "bindings.yaml").write_text(bindings)
    (tmp_path / "faults.yaml").write_text(faults)
    (tmp_path / "guide.yaml").write_text(plan)
    assert read_bindings(tmp_path / "bindings.yaml").of("move").retries == 2
    assert len(read_faults(tmp_path / "faults.yaml").changes) == 1
    assert list(read_plans(tmp_path / "guide.yaml")) == ["guide"]
