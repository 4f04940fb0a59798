"""What a text declares, as the checker looks names up: types, predicates, params, objects, ..."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeAlias

from menid_plan.model.domain import OBJECT, Domain

Types: TypeAlias = tuple[str, ...]
Scope: TypeAlias = dict[str, Types]


# In the place of a type that is not declared; it fits everything, so that one slip is one error.
UNKNOWN = "?"


@dataclass(slots=True)
class Names:
    """The declared names of a domain and, in a problem, of its objects."""

    parents: dict[str, str] = field(default_factory=dict)  # type -> supertype
    predicates: dict[str, tuple[Types, ...]] = field(default_factory=dict)
    derived: dict[str, tuple[Types, ...]] = field(default_factory=dict)
    params: dict[str, float | None] = field(default_factory=dict)  # None: no value can be had
    objects: dict[str, str] = field(default_factory=dict)  # constants, then a problem's objects
    constants: frozenset[str] = frozenset()
    environments: tuple[str, ...] = ()
    _ancestors: dict[str, frozenset[str]] = field(default_factory=dict)

    def for_problem(self) -> Names:
        """A copy whose objects and params a problem may add to and change."""
        return replace(self, objects=dict(self.objects), params=dict(self.params))

    @property
    def types(self) -> list[str]:
        """All types, ``object`` first."""
        return [OBJECT, *self.parents]

    def arguments(self, predicate: str) -> tuple[Types, ...] | None:
        """The argument types of a basic or derived predicate; None if it is not declared."""
        found = self.predicates.get(predicate)
        return self.derived.get(predicate) if found is None else found

    def fits(self, given: Types, asked: Types) -> bool:
        """Whether an object of any of the given types is of one of those asked for."""
        wanted = set(asked)
        if UNKNOWN in wanted or UNKNOWN in given:
            return True  # what is wrong was said where the type was named
        return all(not wanted.isdisjoint(self.ancestors(name)) for name in given)

    def ancestors(self, name: str) -> frozenset[str]:
        """A type and all that it descends from."""
        found = self._ancestors.get(name)
        if found is None:
            chain = {name, OBJECT}
            parent = self.parents.get(name)
            while parent is not None and parent not in chain:
                chain.add(parent)
                parent = self.parents.get(parent)
            found = self._ancestors[name] = frozenset(chain)
        return found


def names_of(domain: Domain, params: dict[str, float]) -> Names:
    """The names of a domain that is without errors."""
    return Names(
        parents={t.name: t.parent for t in domain.types},
        predicates={p.name: p.arguments for p in domain.predicates},
        derived={d.name: tuple(v.types for v in d.parameters) for d in domain.derived},
        params=dict(params),
        objects={c.name: c.type for c in domain.constants},
        constants=frozenset(c.name for c in domain.constants),
        environments=tuple(e.name for e in domain.all_environments),
    )
