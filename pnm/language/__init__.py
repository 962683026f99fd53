"""The language: domains and plans that people write in YAML. Knows nothing of planners.

`read_plans` and `read_world` read files; each plan has a `PlanGraph` and `Bindings` for `pnm.core.machine.generate`.
No file names a class or a module that would be imported.
"""

from typing import TYPE_CHECKING

from pnm.files.lazy_exports import lazily

if TYPE_CHECKING:
    from pnm.language.domain import LanguageDomain
    from pnm.language.files import read_domain
    from pnm.language.plan import HandWrittenPlan, World, parse_plans, read_plans, read_world

__all__ = ["HandWrittenPlan", "LanguageDomain", "World", "parse_plans", "read_domain", "read_plans", "read_world"]

_WHERE = {
    "HandWrittenPlan": "pnm.language.plan",
    "LanguageDomain": "pnm.language.domain",
    "World": "pnm.language.plan",
    "parse_plans": "pnm.language.plan",
    "read_domain": "pnm.language.files",
    "read_plans": "pnm.language.plan",
    "read_world": "pnm.language.plan",
}

__getattr__, __dir__ = lazily(__name__, _WHERE)
