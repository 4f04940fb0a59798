"""States, ground actions and bindings: the values that the semantics speaks of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Final, Literal, NamedTuple, TypeAlias

from menid_plan.model.formulas import Atom, GroundAtom, Term, TypedVariable, Variable

State: TypeAlias = frozenset[GroundAtom]
"""The basic atoms that hold."""

World: TypeAlias = frozenset[GroundAtom]
"""A state together with its derived atoms."""

Binding: TypeAlias = Mapping[str, str]
"""The object that each variable names."""


class Sink(Enum):
    """The type of `SINK`."""

    SINK = "sink"

    def __repr__(self) -> str:
        return "SINK"


SINK: Final = Sink.SINK
"""Where noise leads when planning with it as a sink: absorbing, nothing further happens."""

NextState: TypeAlias = State | Literal[Sink.SINK]


class GroundAction(NamedTuple):
    """An action and the names of the objects that are its arguments."""

    action: str
    arguments: tuple[str, ...] = ()

    def __str__(self) -> str:
        if not self.arguments:
            return self.action
        return f"{self.action}({', '.join(self.arguments)})"


def object_named(term: Term, binding: Binding) -> str:
    """The object that a term names; KeyError for a variable that is not bound."""
    return binding[term.name] if isinstance(term, Variable) else term.name


def ground_atom(atom: Atom, binding: Binding) -> GroundAtom:
    """An atom of the objects that its terms name."""
    names = [binding[t.name] if isinstance(t, Variable) else t.name for t in atom.arguments]
    return GroundAtom(atom.predicate, tuple(names))


def extended(
    binding: Binding, variables: Iterable[TypedVariable], objects: Iterable[str]
) -> dict[str, str]:
    """A binding with some more variables bound, each to the object at its place."""
    return {**binding, **{v.name: o for v, o in zip(variables, objects, strict=True)}}


def state_text(state: Iterable[GroundAtom]) -> str:
    """The atoms of a state, sorted: ``in(board, tray), loose(board)``; ``nothing`` without any."""
    return ", ".join(map(str, sorted(state))) or "nothing"


def binding_text(binding: Binding) -> str:
    """A binding in its order: ``e = n1, p = board``."""
    return ", ".join(f"{variable} = {name}" for variable, name in binding.items())
