"""Every scene has a ROS domain of its own."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TypeVar

import pytest

from tests.support.e2e.plans import PlanScene
from tests.support.e2e.scene import Place, Scene
from tests.support.ros.domains import ros_domain

P = TypeVar("P", bound=Place)


@contextmanager
def staging(folder: Path) -> Iterator[Callable[..., Scene]]:
    """Set scenes; their processes end with the block."""
    with ExitStack() as stack:
        yield lambda name, **options: _set(lambda here, number: Scene(name, here, number, **options), folder, stack)


def _set(make: Callable[[Path, int], P], folder: Path, stack: ExitStack) -> P:
    here = Path(tempfile.mkdtemp(dir=folder))
    scene = make(here, stack.enter_context(ros_domain()))
    stack.callback(scene.close)
    return scene


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Callable[..., Scene]]:
    with staging(tmp_path) as make:
        yield make


@pytest.fixture(scope="module")
def stage_of_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Scene]]:
    """Set scenes that may go on while other tests of the module run."""
    with staging(tmp_path_factory.mktemp("scenes")) as make:
        yield make


@pytest.fixture
def plan_scene(tmp_path: Path) -> Iterator[PlanScene]:
    """A ROS domain without anybody in it."""
    with ExitStack() as stack:
        yield _set(PlanScene, tmp_path, stack)


@pytest.fixture(scope="module")
def plan_scene_of_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlanScene]:
    """The same, for all tests of a module."""
    with ExitStack() as stack:
        yield _set(PlanScene, tmp_path_factory.mktemp("scenes"), stack)
