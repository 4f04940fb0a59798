"""A memory of results for the keys asked about lately."""

from __future__ import annotations

from typing import TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")


class Recent(dict[Key, Value]):
    """A dictionary that forgets everything when it is full, so that it cannot fill the memory."""

    SIZE = 1000

    def __setitem__(self, key: Key, value: Value) -> None:
        if len(self) >= self.SIZE:
            self.clear()
        super().__setitem__(key, value)
