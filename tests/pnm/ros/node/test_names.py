"""Names of action servers that parameters of a plan are part of."""

from __future__ import annotations

import pytest

from pnm.errors import InputError
from pnm.ros.node.graph import server_name


@pytest.mark.parametrize("argument", ["\0", "r1\0", "\0r1", "a\0/b"])
def test_a_zero_character_makes_no_name_of_another_server(ros, argument):
    with pytest.raises(InputError, match="not a name for an action server"):
        ros.wait(lambda: server_name(ros.node, f"/secret/{argument}/go"))
    with pytest.raises(InputError, match="zero character"):
        ros.wait(lambda: server_name(ros.node, f"/secret/go{argument}"))
