"""The table of shared variables, and all statements about it."""

from __future__ import annotations

from typing import Final

from sqlalchemy import Column, Double, MetaData, Table, Text, bindparam, delete, select
from sqlalchemy.dialects.postgresql import insert  # whose ON CONFLICT SQLite has as well

from pnm.files.database.driver import Layout

_TABLES: Final = MetaData()
_variables: Final = Table(
    "variables",
    _TABLES,
    Column("name", Text, primary_key=True),
    Column("value", Text, nullable=False),
    Column("changed", Double, nullable=False),
    Column("run", Text, nullable=False),
)
LAYOUT: Final = Layout("knowledge", 0x504E4D4B, 1, _TABLES)  # PNMK

_STORE: Final = insert(_variables)
_NAMED: Final = _variables.c.name == bindparam("wanted", type_=Text)
STORE: Final = _STORE.on_conflict_do_update(
    index_elements=["name"], set_={"value": _STORE.excluded.value, "changed": _STORE.excluded.changed, "run": _STORE.excluded.run}
)
READ: Final = select(_variables.c.value).where(_NAMED)
FORGET: Final = delete(_variables).where(_NAMED)
