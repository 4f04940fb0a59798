"""Names for other languages: legal there, and different where they were different."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Mapping
from typing import TypeVar

_Thing = TypeVar("_Thing", bound=Hashable)


def names_for(
    things: Iterable[tuple[_Thing, str]], reserved: Iterable[str] = (), *, hyphen: bool = True
) -> dict[_Thing, str]:
    """A name for each thing, by the name that it would best have.

    Names begin with a letter and go on with letters, digits, ``_`` and (with ``hyphen``) ``-``; two
    names differ in more than small and capital letters, and none is a reserved word.
    """
    taken = {word.lower() for word in reserved}
    found: dict[_Thing, str] = {}
    last: dict[str, int] = {}  # the number behind the last name that was wanted like that
    for thing, wanted in things:
        if thing in found:
            continue
        plain = re.sub(r"[^A-Za-z0-9_-]" if hyphen else r"[^A-Za-z0-9_]", "_", wanted)
        if not hyphen:
            # RDDL's readers put parts of names together with `___`, and choke on less.
            plain = re.sub("_+", "_", plain).strip("_")
        if not re.match(r"[A-Za-z]", plain):
            plain = f"x{plain}"
        name, number = plain, last.get(plain, 1)
        while name.lower() in taken:
            number += 1
            name = f"{plain}_{number}"
        last[plain] = number
        taken.add(name.lower())
        found[thing] = name
    return found


def changed(names: Mapping[str, str]) -> dict[str, str]:
    """Of things and what they are called now, by the new names, those that are not just respelt."""
    return {
        new: old
        for old, new in names.items()
        if re.sub(r"[^a-z0-9]", "_", old.lower()) != re.sub(r"[^a-z0-9]", "_", new.lower())
    }
