"""The language: domains and plans that people write in YAML. Knows nothing of planners.

`read_plans` and `read_world` read files; each plan has a `PlanGraph` and `Bindings` for `pnm.core.machine.generate`.
No file names a class or a module that would be imported.
"""

from typing import TYPE_CHECKING

from pnm.files.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from pnm.language.domain import LanguageDomain as LanguageDomain
    from pnm.language.plan import (
        HandWrittenPlan as HandWrittenPlan,
        World as World,
        parse_plans as parse_plans,
        read_domain as read_domain,
        read_plans as read_plans,
        read_world as read_world,
    )
else:
    __all__, __getattr__, __dir__ = lazy_exports(__name__, __file__)
