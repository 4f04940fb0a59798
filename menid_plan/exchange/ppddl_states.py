"""PPDDL, state by state: what every reader of the language takes, for problems with few states.

Every ground action becomes an action without parameters. It applies where it applies in a reachable
state, and says for each of these states what it does there (Younes and Littman 2004 for the language).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from menid_plan.errors import LimitError, MenidError
from menid_plan.grounding.state import SINK, GroundAction, State
from menid_plan.mdp.explore import Structure
from menid_plan.mdp.model import MDP
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom

MAX_TRANSITIONS = 20_000
# Readers keep numbers as fractions of 32-bit integers: more digits would overflow them.
DIGITS = 6
# The proposition that holds once noise has led out of the model.
SUNK = GroundAtom("sunk", ())
_RESERVED = frozenset(
    "and or not imply exists forall when probabilistic increase decrease assign scale-up scale-down"
    " either object reward define domain problem goal total-time".split()
)


class NotExpressibleError(MenidError):
    """The target language can't say something; the message names it."""

    exit_code = 4


def ppddl(domain: Domain, problem: Problem, structure: Structure, mdp: MDP) -> tuple[str, str]:
    """The texts of domain and problem for the reachable states of a problem.

    Actions pay their reward on average, a goal ends an episode; probabilities and rewards have six
    decimals. Discount and horizon have no place in the language and are told in a comment. LimitError
    above 20,000 transitions, NotExpressibleError for names that the language does not tell apart.
    """
    if mdp.transitions > MAX_TRANSITIONS:
        raise LimitError(
            f"problem `{problem.name}` has {mdp.transitions} transitions: PPDDL is written state by"
            f" state, up to {MAX_TRANSITIONS} of them"
        )
    _check_names(p.name for p in domain.predicates)
    _check_names(thing.name for thing in (*domain.constants, *problem.objects))
    model = _Model(domain, problem, structure, mdp)
    return "\n".join(model.domain()) + "\n", "\n".join(model.problem()) + "\n"


def _check_names(names: Iterable[str]) -> None:
    seen: dict[str, str] = {}
    for name in names:
        low = name.lower()
        if low in _RESERVED or low == SUNK.predicate:
            raise NotExpressibleError(f"`{name}` is a word of PPDDL itself: give it another name")
        if seen.setdefault(low, name) != name:
            raise NotExpressibleError(
                f"`{seen[low]}` and `{name}` are one name in PPDDL, which does not tell small from"
                " capital letters: rename one of them"
            )


class _Model:
    def __init__(self, domain: Domain, problem: Problem, structure: Structure, mdp: MDP) -> None:
        self._domain, self._problem, self._mdp = domain, problem, mdp
        states = (structure.state(number) for number in range(mdp.states))
        self._states: list[State] = [frozenset({SUNK}) if s is SINK else s for s in states]
        self._facts = sorted(frozenset().union(*self._states), key=str)
        always = frozenset(self._facts).intersection(*self._states)
        # What tells reachable states from each other.
        self._varying = [fact for fact in self._facts if fact not in always]
        self._actions: dict[GroundAction, list[tuple[int, int]]] = {}
        for state in range(mdp.states):
            for row in range(int(mdp.state_row[state]), int(mdp.state_row[state + 1])):
                self._actions.setdefault(structure.action(row), []).append((state, row))

    def domain(self) -> Iterator[str]:
        d = self._domain
        objects = sorted({name for fact in self._facts for name in fact.arguments})
        arities = {fact.predicate: len(fact.arguments) for fact in self._facts}
        yield f"; {d.name}, as far as {self._problem.name} reaches it, state by state"
        yield f"(define (domain {d.name})"
        yield "  (:requirements :adl :probabilistic-effects :rewards)"
        if objects:
            yield f"  (:constants {' '.join(objects)})"
        yield "  (:predicates"
        for name, arity in arities.items():
            yield f"    ({' '.join([name, *(f'?x{k}' for k in range(1, arity + 1))])})"
        yield "  )"
        names = _names(self._actions)
        for action, places in self._actions.items():
            yield f"  ; {action}"
            yield f"  (:action {names[action]}"
            yield "    :parameters ()"
            where = _either([self._condition(state) for state, _ in places])
            yield f"    :precondition {where}"
            effects = []
            for state, row in places:
                effect = self._effect(state, row)
                if len(places) > 1:
                    effect = f"(when {self._condition(state)}\n        {effect})"
                effects.append(effect)
            yield f"    :effect {_both(effects)})"
        yield ")"

    def problem(self) -> Iterator[str]:
        p, mdp = self._problem, self._mdp
        if mdp.discount < 1:
            yield f"; discount {mdp.discount:g}"
        if mdp.horizon is not None:
            yield f"; horizon {mdp.horizon}"
        yield f"(define (problem {p.name})"
        yield f"  (:domain {self._domain.name})"
        yield f"  (:init {' '.join(_atom(a) for a in sorted(self._states[0], key=str))})"
        if mdp.has_goal:
            reached = np.flatnonzero(mdp.goal).tolist()
            # A goal that can't be reached is what never holds.
            met = _either([self._condition(state) for state in reached]) if reached else "(or)"
            yield f"  (:goal {met})"
        yield "  (:metric maximize (reward))"
        yield ")"

    def _condition(self, state: int) -> str:
        holds = self._states[state]
        return _both([_atom(f) if f in holds else f"(not {_atom(f)})" for f in self._varying])

    def _effect(self, state: int, row: int) -> str:
        mdp = self._mdp
        span = slice(int(mdp.row_transition[row]), int(mdp.row_transition[row + 1]))
        chances: dict[str, float] = {}
        for after, chance in zip(
            mdp.next_state[span].tolist(), mdp.row_probabilities(row).tolist(), strict=True
        ):
            change = _change(self._states[state], self._states[after])
            chances[change] = chances.get(change, 0.0) + chance
        chances.pop("", None)  # what is left of 1 is no change
        parts = []
        if chances:
            shares = _shares(chances)
            choices = " ".join(f"{shares[change]} {change}" for change in chances)
            certain = len(chances) == 1 and float(*shares.values()) == 1
            parts.append(next(iter(chances)) if certain else f"(probabilistic {choices})")
        reward = round(float(mdp.row_reward[row]), DIGITS)
        if reward:
            word = "increase" if reward > 0 else "decrease"
            parts.append(f"({word} (reward) {_number(abs(reward))})")
        return _both(parts)


def _atom(atom: GroundAtom) -> str:
    return f"({' '.join((atom.predicate, *atom.arguments))})"


def _change(before: State, after: State) -> str:
    """The effect that leads from one state to another; empty if they are the same."""
    added = [_atom(a) for a in sorted(after - before, key=str)]
    removed = [f"(not {_atom(a)})" for a in sorted(before - after, key=str)]
    return _both(removed + added) if removed or added else ""


def _shares(chances: Mapping[str, float]) -> dict[str, str]:
    """The chances as texts whose sum is at most 1."""
    unit = 10**DIGITS
    whole = {change: round(chance * unit) for change, chance in chances.items()}
    largest = max(whole, key=whole.__getitem__)
    whole[largest] -= max(sum(whole.values()) - unit, 0)
    return {change: _number(count / unit) for change, count in whole.items()}


def _number(value: float) -> str:
    return f"{value:.{DIGITS}f}".rstrip("0").rstrip(".")


def _both(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"(and {' '.join(parts)})" if parts else "(and)"


def _either(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"(or {' '.join(parts)})"


def _names(actions: Iterable[GroundAction]) -> dict[GroundAction, str]:
    """A name for each ground action; ``a(b_c)`` and ``a_b(c)`` get two."""
    names: dict[GroundAction, str] = {}
    taken: set[str] = set()
    for action in actions:
        plain = name = "_".join((action.action, *action.arguments))
        number = 1
        while name.lower() in taken:
            number += 1
            name = f"{plain}_{number}"
        taken.add(name.lower())
        names[action] = name
    return names
