"""Every deployment has a ROS domain of its own."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TypeVar

import pytest

from tests.support.e2e.deployment import ProblemDeployment, RosDomain
from tests.support.e2e.plan_deployment import PlanDeployment
from tests.support.processes import ros_domain

P = TypeVar("P", bound=RosDomain)


@contextmanager
def deployments(folder: Path) -> Iterator[Callable[..., ProblemDeployment]]:
    """Return a function that deploys problems; their processes end with the block."""
    with ExitStack() as stack:
        yield lambda name, **options: _set(lambda here, number: ProblemDeployment(name, here, number, **options), folder, stack)


def _set(make: Callable[[Path, int], P], folder: Path, stack: ExitStack) -> P:
    here = Path(tempfile.mkdtemp(dir=folder))
    deployment = make(here, stack.enter_context(ros_domain()))
    stack.callback(deployment.close)
    return deployment


@pytest.fixture
def deploy(tmp_path: Path) -> Iterator[Callable[..., ProblemDeployment]]:
    with deployments(tmp_path) as make:
        yield make


@pytest.fixture(scope="module")
def deploy_for_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., ProblemDeployment]]:
    """Deploy problems whose runs may go on while other tests of the module run."""
    with deployments(tmp_path_factory.mktemp("deployments")) as make:
        yield make


@pytest.fixture
def deployment(tmp_path: Path) -> Iterator[PlanDeployment]:
    """A ROS domain without anybody in it."""
    with ExitStack() as stack:
        yield _set(PlanDeployment, tmp_path, stack)


@pytest.fixture(scope="module")
def deployment_of_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlanDeployment]:
    """The same, for all tests of a module."""
    with ExitStack() as stack:
        yield _set(PlanDeployment, tmp_path_factory.mktemp("deployments"), stack)
