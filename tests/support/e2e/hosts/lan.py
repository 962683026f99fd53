"""Hosts: network namespaces on cables to a switch in the middle, and any cable can be pulled out of the switch."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Final, TypeVar

from tests.support.processes import Deployment, Program
from tests.support.ros.middleware import middleware

P = TypeVar("P", bound=Program)

LEASE: Final = 3
"""Seconds after which a process that is not heard is taken for gone, on these hosts."""
_lans = count()


@dataclass(frozen=True)
class Lan:
    """A local network of its own, which nothing outside of it hears of.

    A cable that is pulled leaves both of its ends without a word: as with a real switch, what is sent is just not heard.
    """

    name: str

    def host(self, name: str) -> tuple[str, ...]:
        """Return what a command begins with that is run on the host."""
        return ("ip", "netns", "exec", f"{self.name}-{name}")

    def cut(self, host: str) -> None:
        """Pull the host's cable."""
        _ip("-n", f"{self.name}-switch", "link", "set", host, "nomaster")

    def heal(self, host: str) -> None:
        """Put the host's cable back."""
        _ip("-n", f"{self.name}-switch", "link", "set", host, "master", "switch")


@contextmanager
def lan(*hosts: str) -> Iterator[Lan]:
    """Have hosts on one network, which is gone at the end.

    Raises:
        RuntimeError: this machine does not allow network namespaces; root may make them.
    """
    made = Lan(f"pnm{os.getpid()}-{next(_lans)}")
    try:
        _ip("netns", "add", f"{made.name}-switch")
        _ip("-n", f"{made.name}-switch", "link", "add", "name", "switch", "up", "type", "bridge", "mcast_snooping", "0")
        for number, host in enumerate(hosts, 1):
            _connect(made, host, f"10.0.0.{number}/24")
        yield made
    finally:
        for name in ("switch", *hosts):
            subprocess.run(["ip", "netns", "delete", f"{made.name}-{name}"], capture_output=True, check=False)


class HostsDeployment(Deployment):
    """Programs on the hosts of a network, which end with it.

    Args:
        lan: has the hosts.
        folder: for the files.
    """

    def __init__(self, lan: Lan, folder: Path) -> None:
        super().__init__(folder, middleware(folder, 0, lease=LEASE, has_network=True))  # the network is nobody else's
        self.lan = lan

    def _started(self, kind: type[P], host: str, *arguments: str) -> P:
        return self.start(kind(["-m", *arguments], self.environment, self.lan.host(host)))


def _connect(made: Lan, host: str, address: str) -> None:
    space = f"{made.name}-{host}"
    _ip("netns", "add", space)
    _ip("link", "add", "net0", "netns", space, "type", "veth", "peer", "name", host, "netns", f"{made.name}-switch")
    _ip("-n", f"{made.name}-switch", "link", "set", host, "master", "switch", "up")
    _ip("-n", space, "address", "add", address, "dev", "net0")
    for device in ("lo", "net0"):
        _ip("-n", space, "link", "set", device, "up")


def why_not() -> str:
    """Return why this machine cannot have several hosts; empty when it can. What is missing is not to be had with pip."""
    if shutil.which("ip") is None:
        return "there is no command ip (package iproute2)"
    tried = subprocess.run(["unshare", "--net", "true"], capture_output=True, text=True, check=False)
    return f"network namespaces are not allowed here: {tried.stderr.strip()}" if tried.returncode else ""


def _ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"network namespaces are needed, which root may make: ip {' '.join(arguments)}: {done.stderr.strip()}")
