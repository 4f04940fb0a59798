"""Settings from TOML tables: frozen dataclasses, each key checked by its name and its type."""

from __future__ import annotations

import json
import math
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, TypeVar, Union

from menid_plan.errors import MenidError
from menid_plan.language.hints import similar

T = TypeVar("T")

_WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
_PLURALS = {float: "numbers", int: "whole numbers", str: "texts"}


class SettingError(MenidError):
    """A setting has a value that does not do. ``key`` is its name; empty where there is no such one.

    ``file`` is where it stands, if that is known.

    Settings raise it from their ``__post_init__``, or where they meet the domain.
    """

    exit_code = 3

    def __init__(self, key: str, message: str, file: str = "") -> None:
        super().__init__(key, message, file)
        self.key = key
        self.message = message
        self.file = file

    def __str__(self) -> str:
        return ": ".join(part for part in (self.file, self.key, self.message) if part)


def read_settings(
    kind: type[T], table: Mapping[str, object], where: str = ""
) -> tuple[T | None, list[str]]:
    """The settings that a table holds, or what is wrong with it, a line for each key.

    ``kind`` is a dataclass whose fields are numbers, texts, truth values, Literals, tuples and
    Mappings of these, ``object`` for anything, other such dataclasses, or unions of them. ``where``
    is what the table is called in messages. None if anything is wrong.
    """
    faults: list[str] = []
    assert is_dataclass(kind)
    hints = typing.get_type_hints(kind)
    known = {field.name: field for field in fields(kind) if field.init}
    prefix = f"{where}." if where else ""
    for key in table:
        if key not in known:
            faults.append(f"{prefix}{key}: {unknown('key', key, known)}")
    values: dict[str, Any] = {}
    for name, field in known.items():
        if name in table:
            values[name] = _read(table[name], hints[name], f"{prefix}{name}", faults)
        elif field.default is MISSING and field.default_factory is MISSING:
            faults.append(f"{prefix}{name}: it is missing; expected {_expected(hints[name])}")
    if faults:
        return None, faults
    try:
        return typing.cast("T", kind(**values)), []
    except SettingError as error:
        return None, [f"{prefix}{error}"]


def unknown(what: str, name: str, known: typing.Iterable[str]) -> str:
    """That a name is not known, and which one may be meant."""
    names = sorted(known)
    guess = similar(name, names, 0.6)
    if guess is not None:
        return f"unknown {what}; did you mean `{guess}`?"
    return f"unknown {what}; there are: {', '.join(names) or 'none'}"


def check_range(
    settings: object,
    key: str,
    *,
    least: float = 0.0,
    most: float = math.inf,
    above: bool = False,
) -> None:
    """Raise SettingError unless a setting (or each entry of a table) is at least, or above, a number.

    It must be finite, and ``most`` at the most. None is let through.
    """
    value = getattr(settings, key)
    entries = value.items() if isinstance(value, Mapping) else [("", value)]
    for name, number in entries:
        if number is None:
            continue
        if isinstance(number, float) and not math.isfinite(number):
            asked = "a finite number"
        elif number < least or (above and number == least):
            asked = f"more than {least:g}" if above else f"at least {least:g}"
        elif number > most:
            asked = f"at most {most:g}"
        else:
            continue
        where = f"{key}.{name}" if name else key
        raise SettingError(where, f"expected {asked}, not {number:.6g}")


def _read(value: object, hint: Any, where: str, faults: list[str]) -> Any:
    """The value as the hint asks for it; appends what is wrong with it."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint in (object, Any):
        return value
    if origin in (Union, types.UnionType):
        return _read_union(value, arguments, where, faults)
    if is_dataclass(hint) and isinstance(hint, type) and isinstance(value, dict):
        found, wrong = read_settings(hint, value, where)
        faults.extend(wrong)
        return found
    if origin in (tuple, Sequence, list) and isinstance(value, list):
        return tuple(
            _read(item, arguments[0], f"{where}[{index}]", faults)
            for index, item in enumerate(value)
        )
    if origin in (dict, Mapping) and isinstance(value, dict):
        return {
            key: _read(item, arguments[1], f"{where}.{key}", faults) for key, item in value.items()
        }
    if _fits(value, hint):
        return float(value) if hint is float else value  # type: ignore[arg-type]
    faults.append(f"{where}: expected {_expected(hint)}, not {shown(value)}")
    return None


def _read_union(value: object, members: Sequence[Any], where: str, faults: list[str]) -> Any:
    attempts = []
    for member in members:
        wrong: list[str] = []
        found = _read(value, member, where, wrong)
        if not wrong:
            return found
        attempts.append(wrong)
    # What is wrong inside of a table says more than that it is no number.
    inside = [a for a in attempts if not all(fault.startswith(f"{where}:") for fault in a)]
    expected = " or ".join(_expected(m) for m in members if m is not type(None))
    faults.extend(inside[0] if inside else [f"{where}: expected {expected}, not {shown(value)}"])
    return None


def _fits(value: object, hint: Any) -> bool:
    if typing.get_origin(hint) is Literal:
        return value in typing.get_args(hint)
    if hint is float:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return number and math.isfinite(typing.cast("float", value))
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(hint, type) and isinstance(value, hint)


def _expected(hint: Any) -> str:
    """What a hint asks for, in words."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint in (object, Any):
        return "a value"
    if origin is Literal:
        return " or ".join(shown(a) for a in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(_expected(a) for a in arguments if a is not type(None))
    if origin in (tuple, Sequence, list):
        return f"a list of {_PLURALS.get(arguments[0], 'values')}"
    if origin in (dict, Mapping):
        return f"a table of {_PLURALS.get(arguments[1], 'values')}"
    return _WORDS.get(hint, "a table")


_NOTHING = object()


def differences(before: Any, now: Any, key: str = "") -> typing.Iterator[tuple[str, str, str]]:
    """The keys at which two tables differ, each with the values there as texts."""
    if isinstance(before, dict) and isinstance(now, dict):
        for name in dict.fromkeys((*before, *now)):
            inner = f"{key}.{name}" if key else name
            yield from differences(before.get(name, _NOTHING), now.get(name, _NOTHING), inner)
    elif before != now:
        there, here = (
            "nothing" if value is _NOTHING else json.dumps(value) for value in (before, now)
        )
        yield key, there, here


def shown(value: object, width: int = 60) -> str:
    """A value as TOML writes it, shortened."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= width else f"{text[: width - 1]}…"
