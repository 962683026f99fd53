"""ROS 2 action servers: of goals, of simulated robots, and for your own servers in Python, with the knowledge of the run that asks."""

from typing import TYPE_CHECKING

from pnm.files.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from pnm.ros.action_server.python_server import LIMIT as LIMIT, KnowledgeError as KnowledgeError, PnmActionServer as PnmActionServer
else:
    __all__, __getattr__, __dir__ = lazy_exports(__name__, __file__)
