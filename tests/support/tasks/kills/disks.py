"""A small disk, which can be filled and freed: a real one where that is allowed, and limits of processes elsewhere."""

from __future__ import annotations

import resource
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Disk:
    """A disk of its own, or a folder.

    Args:
        folder: where it is.
        is_real: whether it is a file system of its own; otherwise a process that writes can write no more when it is full.
    """

    folder: Path
    is_real: bool

    def fill(self, process: int) -> None:
        """Leave no space for this process."""
        if not self.is_real:
            resource.prlimit(process, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
            return
        with suppress(OSError), self._ballast.open("ab", buffering=0) as file:
            while True:
                file.write(bytes(1024))

    def free(self, process: int) -> None:
        """Give the space back."""
        if self.is_real:
            self._ballast.unlink()
        else:
            with suppress(ProcessLookupError):
                resource.prlimit(process, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))

    @property
    def _ballast(self) -> Path:
        return self.folder / "ballast"


@contextmanager
def small_disk(folder: Path) -> Iterator[Disk]:
    """Mount a disk of 2 MB in a folder that is made for it."""
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(folder)], capture_output=True, check=False)
    try:
        yield Disk(folder, mounted.returncode == 0)
    finally:
        if mounted.returncode == 0:
            subprocess.run(["umount", "--lazy", str(folder)], check=True)
