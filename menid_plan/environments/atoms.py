"""Atoms and actions as texts, as environments speak of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from menid_plan.environments.settings import unknown
from menid_plan.errors import MeaningError
from menid_plan.experience.check import AtomChecker
from menid_plan.grounding.state import GroundAction, State
from menid_plan.model.domain import Domain, Predicate, Problem
from menid_plan.model.formulas import GroundAtom

_NAME = r"[A-Za-z_][A-Za-z0-9_]*(?:-[A-Za-z0-9_]+)*"
_LIST = rf"{_NAME}\s*(?:,\s*{_NAME}\s*)*"
_ATOM = re.compile(rf"\s*({_NAME})\s*(?:\(\s*({_LIST})?\))?\s*", re.ASCII)

# Texts that were found right are kept; this bounds what a program can do by writing one atom in many
# ways.
_KEPT = 100_000


class Vocabulary:
    """The basic atoms and the actions of a problem."""

    def __init__(self, domain: Domain, problem: Problem) -> None:
        self._checker = AtomChecker(domain, problem)
        # Of actions the same is asked as of predicates.
        actions = tuple(
            Predicate(a.name, tuple(v.types for v in a.parameters)) for a in domain.actions
        )
        self._actions = [a.name for a in domain.actions]
        self._action_checker = AtomChecker(replace(domain, predicates=actions, derived=()), problem)
        self._read: dict[str, GroundAtom] = {}

    def atom(self, text: str) -> GroundAtom:
        """The atom that a text such as ``in(board, tray)`` stands for.

        Raises MeaningError if it stands for none of the problem's.
        """
        found = self._read.get(text)
        if found is None:
            found = _parsed(text)
            self._checker.check((found,))
            if len(self._read) < _KEPT:
                self._read[text] = found
        return found

    def action(self, text: str) -> GroundAction:
        """The action that a text such as ``lever(n1)`` stands for; raises MeaningError."""
        found = _parsed(text)
        if found.predicate not in self._actions:
            message = unknown("action", found.predicate, self._actions)
            raise MeaningError(f"`{found}`: {message}")
        self._action_checker.check((found,))
        return GroundAction(*found)

    def state(self, texts: Iterable[str]) -> State:
        """The state of some atoms; raises MeaningError."""
        return frozenset([self.atom(text) for text in texts])

    def check(self, state: State) -> None:
        """Raise MeaningError, naming an atom, unless all are basic atoms of the problem."""
        self._checker.check(state)


def _parsed(text: str) -> GroundAtom:
    match = _ATOM.fullmatch(text)
    if match is None:
        raise MeaningError(f"`{text[:80]}` is no atom; expected something like p(x, y)")
    arguments = [name.strip() for name in match[2].split(",")] if match[2] else []
    return GroundAtom(match[1], tuple(arguments))


def state_texts(state: Iterable[GroundAtom]) -> list[str]:
    """The atoms of a state as texts, sorted."""
    return [str(atom) for atom in sorted(state)]
