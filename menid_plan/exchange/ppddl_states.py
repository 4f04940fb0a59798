"""PPDDL, state by state: what every reader of the language takes, for problems with few states.

What a ground action does in one reachable state becomes an action without parameters, which applies
there alone (Younes and Littman 2004 for the language).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from menid_plan.errors import LimitError
from menid_plan.exchange.flat import Call, unused
from menid_plan.exchange.names import changed, names_for
from menid_plan.exchange.numbers import Numbers
from menid_plan.exchange.ppddl import RESERVED, Written
from menid_plan.grounding.state import SINK, State
from menid_plan.mdp.explore import Structure
from menid_plan.mdp.model import MDP
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import Constant, GroundAtom

MAX_TRANSITIONS = 20_000


def ppddl_states(domain: Domain, problem: Problem, structure: Structure, mdp: MDP) -> Written:
    """The texts of domain and problem for the reachable states of a problem.

    Actions pay their reward on average, a goal ends an episode; probabilities and rewards have six
    decimals. Discount and horizon have no place in the language and are told in a comment. LimitError
    above 20,000 transitions.
    """
    if mdp.transitions > MAX_TRANSITIONS:
        raise LimitError(
            f"problem `{problem.name}` has {mdp.transitions} transitions: PPDDL is written state by"
            f" state, up to {MAX_TRANSITIONS} of them"
        )
    model = _Model(domain, problem, structure, mdp)
    return model.written()


class _Model:
    def __init__(self, domain: Domain, problem: Problem, structure: Structure, mdp: MDP) -> None:
        self._domain, self._problem, self._mdp = domain, problem, mdp
        states = (structure.state(number) for number in range(mdp.states))
        predicates = {p.name for p in domain.predicates}
        self._sunk = GroundAtom(unused("sunk", predicates))
        self._states: list[State] = [frozenset({self._sunk}) if s is SINK else s for s in states]
        self._facts = sorted(frozenset().union(*self._states), key=str)
        always = frozenset(self._facts).intersection(*self._states)
        # What tells reachable states from each other.
        self._varying = [fact for fact in self._facts if fact not in always]
        self._rows = [
            (state, row, structure.action(row))
            for state in range(mdp.states)
            for row in range(int(mdp.state_row[state]), int(mdp.state_row[state + 1]))
        ]
        self._names = names_for(
            ((row, "_".join((a.action, *a.arguments))) for _, row, a in self._rows), RESERVED
        )
        used = dict.fromkeys(fact.predicate for fact in self._facts)
        self._predicates = names_for(((name, name) for name in used), RESERVED)
        objects = sorted({name for fact in self._facts for name in fact.arguments})
        self._objects = names_for(((name, name) for name in objects), RESERVED)
        self._numbers = Numbers()

    def written(self) -> Written:
        """The texts, and what the names in them stand for."""
        calls: dict[str, tuple[tuple[str, ...], Call]] = {
            self._names[row].lower(): (
                (),
                Call(
                    action.action, tuple(map(Constant, action.arguments)), state=self._states[state]
                ),
            )
            for state, row, action in self._rows
        }
        domain, problem = ("\n".join(lines) + "\n" for lines in (self.domain(), self.problem()))
        sunk = self._sunk.predicate if self._sunk in self._facts else ""
        renamed = {**changed(self._predicates), **changed(self._objects)}
        return Written(
            domain, problem, self._predicates, self._objects, calls, renamed,
            self._numbers.rounded, sunk,
        )  # fmt: skip

    def domain(self) -> Iterator[str]:
        d = self._domain
        arities = {fact.predicate: len(fact.arguments) for fact in self._facts}
        yield f"; {d.name}, as far as {self._problem.name} reaches it, state by state"
        yield f"(define (domain {_name(d.name)})"
        yield "  (:requirements :adl :probabilistic-effects :rewards)"
        if self._objects:
            yield f"  (:constants {' '.join(self._objects.values())})"
        yield "  (:predicates"
        for name, arity in arities.items():
            variables = (f"?x{k}" for k in range(1, arity + 1))
            yield f"    ({' '.join([self._predicates[name], *variables])})"
        yield "  )"
        for state, row, _ in self._rows:
            yield f"  (:action {self._names[row]}"
            yield "    :parameters ()"
            yield f"    :precondition {self._condition(state)}"
            yield f"    :effect {self._effect(state, row)})"
        yield ")"

    def problem(self) -> Iterator[str]:
        p, mdp = self._problem, self._mdp
        if mdp.discount < 1:
            yield f"; discount {mdp.discount:g}"
        if mdp.horizon is not None:
            yield f"; horizon {mdp.horizon}"
        yield f"(define (problem {_name(p.name)})"
        yield f"  (:domain {_name(self._domain.name)})"
        yield f"  (:init {' '.join(self._atom(a) for a in sorted(self._states[0], key=str))})"
        if mdp.has_goal:
            reached = np.flatnonzero(mdp.goal).tolist()
            # A goal that can't be reached is what never holds.
            met = _either([self._condition(state) for state in reached]) if reached else "(or)"
            yield f"  (:goal {met})"
        yield "  (:metric maximize (reward))"
        yield ")"

    def _condition(self, state: int) -> str:
        holds = self._states[state]
        return _both(
            [self._atom(f) if f in holds else f"(not {self._atom(f)})" for f in self._varying]
        )

    def _atom(self, atom: GroundAtom) -> str:
        names = (self._objects[name] for name in atom.arguments)
        return f"({' '.join((self._predicates[atom.predicate], *names))})"

    def _change(self, before: State, after: State) -> str:
        """The effect that leads from one state to another; empty if they are the same."""
        added = [self._atom(a) for a in sorted(after - before, key=str)]
        removed = [f"(not {self._atom(a)})" for a in sorted(before - after, key=str)]
        return _both(removed + added) if removed or added else ""

    def _effect(self, state: int, row: int) -> str:
        mdp = self._mdp
        span = slice(int(mdp.row_transition[row]), int(mdp.row_transition[row + 1]))
        chances: dict[str, float] = {}
        for after, chance in zip(
            mdp.next_state[span].tolist(), mdp.row_probabilities(row).tolist(), strict=True
        ):
            change = self._change(self._states[state], self._states[after])
            chances[change] = chances.get(change, 0.0) + chance
        chances.pop("", None)  # what is left of 1 is no change
        parts = []
        if chances:
            whole = sum(chances.values()) > 1 - 1e-9
            texts = self._numbers.shares(list(chances.values()), whole=whole)
            choices = " ".join(
                f"{text} {change}" for text, change in zip(texts, chances, strict=True)
            )
            certain = len(chances) == 1 and whole
            parts.append(next(iter(chances)) if certain else f"(probabilistic {choices})")
        reward = float(mdp.row_reward[row])
        text = self._numbers.text(abs(reward))
        if text != "0":
            parts.append(f"({'increase' if reward > 0 else 'decrease'} (reward) {text})")
        return _both(parts)


def _name(name: str) -> str:
    return names_for([(name, name)], RESERVED)[name]


def _both(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"(and {' '.join(parts)})" if parts else "(and)"


def _either(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"(or {' '.join(parts)})"
