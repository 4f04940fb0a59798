"""What a store writes in its columns for states, actions, explanations and seeds."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable

from menid_plan.experience.record import Explanation
from menid_plan.grounding.state import GroundAction, State
from menid_plan.model.formulas import GroundAtom

_LARGEST = 2**63 - 1

_ATOM = re.compile(r"([^\s(),]+)(?:\(([^()]*)\))?(?:, |$)")


def atoms_column(state: Iterable[GroundAtom]) -> str:
    """A state as its atoms in order: ``in(board, tray), loose(board)``; empty without any."""
    return ", ".join(map(str, sorted(state)))


def state_of(column: str) -> State:
    """The state of a column of atoms; ValueError if it is none."""
    atoms = [
        GroundAtom(name, tuple(arguments.split(", ")) if arguments else ())
        for name, arguments in _ATOM.findall(column)
    ]
    if atoms_column(atoms) != column:
        raise ValueError(f"`{column}` is no list of atoms")
    return frozenset(atoms)


def action_of(column: str) -> GroundAction:
    """The ground action of a column, which has its text: ``lever(n1)``; ValueError if it is none."""
    found = list(state_of(column))
    if len(found) != 1:
        raise ValueError(f"`{column}` is no action")
    return GroundAction(*found[0])


def explanation_columns(action: str, explanation: Explanation) -> tuple[str, ...]:
    """The action's name, the rule, the values of ``per`` and the weights, the last two as JSON."""
    weights = [float(weight) for weight in explanation.weights]
    per = json.dumps(explanation.values)
    return action, explanation.rule, per, json.dumps(weights)


def explanation_of(rule: str, per: str, weights: str) -> Explanation:
    """The explanation of some columns; ValueError if they are none."""
    try:
        values, shares = json.loads(per), json.loads(weights)
    except (ValueError, RecursionError):
        raise ValueError("its values or weights are no JSON") from None
    if not isinstance(values, list) or not isinstance(shares, list):
        raise ValueError("its values or weights are no list")
    return Explanation(rule, tuple(values), tuple(shares))


def seed_column(seed: int) -> int | str:
    """A seed: a number where SQLite can hold it, its digits beyond 63 bits."""
    seed = int(seed)
    return seed if -_LARGEST <= seed <= _LARGEST else str(seed)
