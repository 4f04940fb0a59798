"""Stratification: in which order derived predicates are computed, and what forbids any order.

An occurrence of a predicate in a formula is positive or negative. ``not``, the left of
``implies``, and ``count`` with ``<`` or ``<=`` turn its sign; inside ``count`` with ``=`` or ``!=``
it is negative whatever surrounds it; all else keeps it. No derived predicate may depend on itself
through a negative occurrence.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from menid_plan.model.domain import DerivedPredicate, Domain
from menid_plan.model.formulas import (
    And,
    Atom,
    Count,
    Equality,
    Exists,
    ForAll,
    Formula,
    Implies,
    Not,
    Or,
    Truth,
)
from menid_plan.model.graph import components


class _Sign(Enum):
    POSITIVE = "positive"
    NEGATIVE = "negative"
    MIXED = "inside a count with = or !=, where turning the sign makes no difference"

    def turned(self) -> _Sign:
        match self:
            case _Sign.POSITIVE:
                return _Sign.NEGATIVE
            case _Sign.NEGATIVE:
                return _Sign.POSITIVE
            case _Sign.MIXED:
                return self


@dataclass(frozen=True, slots=True)
class NegativeCycle:
    """Derived predicates each of which depends on the next, the last on the first.

    The formula of the first, ``culprit``, has a negative occurrence of the one after it (of itself
    if it is alone).
    """

    predicates: tuple[DerivedPredicate, ...]

    @property
    def culprit(self) -> DerivedPredicate:
        """The derived predicate whose formula has the negative occurrence."""
        return self.predicates[0]

    @property
    def negated(self) -> DerivedPredicate:
        """The derived predicate that occurs negatively in the culprit's formula."""
        return self.predicates[1 % len(self.predicates)]

    def __str__(self) -> str:
        return " -> ".join(p.name for p in (*self.predicates, self.culprit))


def occurrences(formula: Formula) -> Iterator[tuple[str, bool]]:
    """The predicates that occur in a formula, in order, each with whether that is negative."""
    pending = [(formula, _Sign.POSITIVE)]
    while pending:
        current, sign = pending.pop()
        match current:
            case Truth() | Equality():
                pass
            case Atom(predicate, _):
                yield predicate, sign is not _Sign.POSITIVE
            case Not(operand):
                pending.append((operand, sign.turned()))
            case And(formulas) | Or(formulas):
                pending.extend((f, sign) for f in reversed(formulas))
            case Implies(left, right):
                pending += [(right, sign), (left, sign.turned())]
            case Exists(_, body) | ForAll(_, body) | Count(_, body, ">" | ">=", _):
                pending.append((body, sign))
            case Count(_, body, "<" | "<=", _):
                pending.append((body, sign.turned()))
            case Count(_, body, _, _):
                pending.append((body, _Sign.MIXED))


def is_recursive(stratum: Sequence[DerivedPredicate]) -> bool:
    """Whether the predicates of a stratum depend on themselves or each other."""
    own = {predicate.name for predicate in stratum}
    return any(name in own for p in stratum for name, _ in occurrences(p.formula))


def strata(domain: Domain) -> list[list[DerivedPredicate]]:
    """The derived predicates in groups; each depends on its own group and on earlier ones alone.

    The groups are as small as can be: predicates share one only if they depend on each other.
    Within a group they stand in order of declaration.
    """
    predicates = _by_name(domain)
    position = {name: index for index, name in enumerate(predicates)}
    return [
        [predicates[name] for name in sorted(component, key=position.__getitem__)]
        for component in components(_dependencies(predicates))
    ]


def negative_cycles(domain: Domain) -> list[NegativeCycle]:
    """What violates stratification: one cycle for each group of predicates that has any.

    Each begins with the first predicate, in order of declaration, whose formula negates another of
    its group, and is as short as can be from there.
    """
    dependencies = _dependencies(_by_name(domain))
    found = []
    for stratum in strata(domain):
        group = {p.name: p for p in stratum}
        for predicate in stratum:
            negated = (n for n, negative in occurrences(predicate.formula) if negative)
            name = next((n for n in negated if n in group), None)
            if name is not None:
                path = _shortest_path(dependencies, name, predicate.name, group)
                cycle = (predicate, *(group[n] for n in path[:-1]))
                found.append(NegativeCycle(cycle))
                break
    return found


def _by_name(domain: Domain) -> dict[str, DerivedPredicate]:
    """The derived predicates; of several with one name (an error of its own), the first."""
    predicates: dict[str, DerivedPredicate] = {}
    for predicate in domain.derived:
        predicates.setdefault(predicate.name, predicate)
    return predicates


def _dependencies(predicates: Mapping[str, DerivedPredicate]) -> dict[str, tuple[str, ...]]:
    """For each derived predicate, the derived predicates in its formula, each once, in order."""
    return {
        name: tuple(dict.fromkeys(n for n, _ in occurrences(p.formula) if n in predicates))
        for name, p in predicates.items()
    }


def _shortest_path(
    graph: Mapping[str, tuple[str, ...]], start: str, end: str, within: Collection[str]
) -> list[str]:
    """The nodes from ``start`` to ``end``, both included, by nodes of one component alone."""
    came_from: dict[str, str | None] = {start: None}
    queue = deque([start])
    while end not in came_from:
        node = queue.popleft()
        for successor in graph[node]:
            if successor in within and successor not in came_from:
                came_from[successor] = node
                queue.append(successor)
    path: list[str] = []
    step: str | None = end
    while step is not None:
        path.append(step)
        step = came_from[step]
    return path[::-1]
