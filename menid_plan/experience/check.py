"""Whether atoms are such as a state of a problem can have; what comes from outside is asked this."""

from __future__ import annotations

from collections.abc import Iterable

from menid_plan.errors import MeaningError
from menid_plan.model.domain import Domain, Problem, objects_by_type
from menid_plan.model.formulas import GroundAtom


def check_state(domain: Domain, problem: Problem, atoms: Iterable[GroundAtom]) -> None:
    """Raise MeaningError, naming the atom, unless all are ground basic atoms of the problem.

    Who checks many states of one problem makes an `AtomChecker`, which knows atoms again.
    """
    AtomChecker(domain, problem).check(atoms)


class AtomChecker:
    """Checks atoms of one problem; each distinct one is looked at once."""

    def __init__(self, domain: Domain, problem: Problem) -> None:
        self._predicates = {p.name: p.arguments for p in domain.predicates}
        self._derived = {p.name for p in domain.derived}
        everything = (*domain.constants, *problem.objects)
        self._objects = {o.name for o in everything}
        self._members = {
            name: frozenset(members)
            for name, members in objects_by_type(domain, everything).items()
        }
        self._good: set[GroundAtom] = set()

    def check(self, atoms: Iterable[GroundAtom]) -> None:
        """Raise MeaningError, naming the first atom in order that no state can have."""
        try:
            unknown = set(atoms) - self._good
        except TypeError:
            raise MeaningError(f"{atoms!r} is no set of atoms") from None
        for atom in sorted(unknown, key=str):
            fault = self._fault(atom)
            if fault:
                raise MeaningError(fault)
        self._good |= unknown

    def _fault(self, atom: object) -> str:
        """What is wrong with an atom; empty if nothing is."""
        if not isinstance(atom, GroundAtom):
            return f"{atom!r} is no atom: a GroundAtom is asked for"
        arguments = self._predicates.get(atom.predicate)
        if arguments is None:
            if atom.predicate in self._derived:
                return f"`{atom}`: `{atom.predicate}` is derived; a state has basic atoms only"
            return f"`{atom}`: there is no predicate `{atom.predicate}`"
        if len(arguments) != len(atom.arguments):
            return (
                f"`{atom}`: `{atom.predicate}` has {len(arguments)} arguments, "
                f"not {len(atom.arguments)}"
            )
        for types, name in zip(arguments, atom.arguments, strict=True):
            if name not in self._objects:
                return f"`{atom}`: there is no object `{name}`"
            if not any(name in self._members[t] for t in types):
                return f"`{atom}`: object `{name}` is not of type {' | '.join(types)}"
        return ""
