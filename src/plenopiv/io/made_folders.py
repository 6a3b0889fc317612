"""Folders that are made on the way, and removed again where nothing came to lie in them."""

from __future__ import annotations

from pathlib import Path


class MadeFolders:
    """Those that ``make`` made, until ``keep``."""

    def __init__(self) -> None:
        self._made: list[Path] = []

    def make(self, folder: Path) -> None:
        """Make a folder and those above it that are missing.

        Raises:
            OSError: one cannot be made; those before it are to be removed.
        """
        for each in reversed([folder, *folder.parents]):
            if not each.exists():
                each.mkdir(exist_ok=True)
                self._made.append(each)

    def keep(self) -> None:
        """Remove none of them."""
        self._made = []

    def remove(self) -> None:
        """Remove those that are empty, the last one first."""
        while self._made:
            try:
                self._made.pop().rmdir()
            except FileNotFoundError:
                continue
            except OSError:  # something lies in it
                break
