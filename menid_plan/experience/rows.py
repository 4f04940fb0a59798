"""The rows of a store, read and checked: what a file holds may be what nobody meant to write."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from menid_plan.errors import InputError, MeaningError
from menid_plan.experience import codec
from menid_plan.experience.check import AtomChecker
from menid_plan.experience.record import DistributionKey, Explanation
from menid_plan.experience.schema import StoreInputError
from menid_plan.grounding.state import GroundAction, State
from menid_plan.language.files import parse_text
from menid_plan.model.domain import Domain, Problem, objects_by_type
from menid_plan.model.probabilities import is_one
from menid_plan.model.rules import Rule

Explained: TypeAlias = tuple[DistributionKey, Explanation]
"""An explanation, and before it the distribution that it is evidence for."""

_LARGEST = "1.7976931348623157e308"

# What is wrong with the numbers of an experience, in one pass through the table.
_FAULTS = f"""
SELECT e.id, CASE
    WHEN v.id IS NULL THEN 'its environment is not there'
    WHEN s.id IS NULL THEN 'its state is not there'
    WHEN a.id IS NULL THEN 'its action is not there'
    WHEN t.id IS NULL THEN 'its state after is not there'
    WHEN e.explanation IS NOT NULL AND x.id IS NULL THEN 'its explanation is not there'
    WHEN x.action <> a.text AND x.action || '(' <> substr(a.text, 1, length(x.action) + 1)
        THEN 'its explanation is of another action'
    WHEN e.reward IS NOT NULL AND NOT (typeof(e.reward) IN ('real', 'integer')
        AND abs(e.reward) <= {_LARGEST}) THEN 'its reward is no finite number'
    WHEN NOT (typeof(e.duration) IN ('real', 'integer') AND e.duration BETWEEN 0 AND {_LARGEST})
        THEN 'its duration is no finite number >= 0'
    WHEN NOT (typeof(e.finished) IN ('real', 'integer') AND abs(e.finished) <= {_LARGEST})
        THEN 'the time of its end is no finite number'
    WHEN typeof(e.seed) <> 'integer' AND NOT (typeof(e.seed) = 'text'
        AND length(e.seed) BETWEEN 1 AND 4000 AND ltrim(substr(e.seed, 1, 1), '-') || substr(e.seed, 2)
            NOT GLOB '*[^0-9]*' AND e.seed <> '-') THEN 'its seed is no whole number'
    WHEN v.role = 'target' AND NOT (e.test IS NULL AND typeof(e.step) = 'integer' AND e.step >= 0)
        THEN 'it is in the target, and its step is no whole number >= 0'
    WHEN v.role <> 'target' AND NOT (e.step IS NULL AND typeof(e.test) = 'integer' AND e.test >= 0)
        THEN 'it is a test, and its number is no whole number >= 0'
    END AS fault
FROM experiences e
    LEFT JOIN environments v ON v.id = e.environment
    LEFT JOIN states s ON s.id = e.state
    LEFT JOIN actions a ON a.id = e.action
    LEFT JOIN states t ON t.id = e.after
    LEFT JOIN explanations x ON x.id = e.explanation
WHERE fault IS NOT NULL ORDER BY e.id LIMIT 1
"""  # noqa: S608 - a number of our own

# The tables that experiences refer to: what a row is called, its columns, and where experiences use it.
_TABLES = {
    "states": ("state", "atoms", "? IN (state, after)"),
    "actions": ("action", "text", "action = ?"),
    "explanations": ("explanation", "action, rule, per, weights", "explanation = ?"),
}


class Rows:
    """Reads the rows of the store of a domain and problem.

    Each method raises ValueError, which says in words what is wrong.
    """

    def __init__(self, domain: Domain, problem: Problem) -> None:
        self._atoms = AtomChecker(domain, problem)
        self._actions = {a.name: a for a in domain.actions}
        self._rules = {(a.name, r.name): r for a in domain.actions for r in a.rules}
        everything = (*domain.constants, *problem.objects)
        self._objects = {o.name for o in everything}
        self._members = {
            name: frozenset(members)
            for name, members in objects_by_type(domain, everything).items()
        }

    def read(self, table: str, cells: tuple[Any, ...]) -> Any:
        """What a row of a table holds: a state, an action, or an explanation with its distribution."""
        if not all(isinstance(cell, str) for cell in cells):
            raise ValueError("it is no text")
        value: Any
        if table == "states":
            value = codec.state_of(cells[0])
            self.check_state(value)
        elif table == "actions":
            value = codec.action_of(cells[0])
            self.check_action(value)
        else:
            explanation = codec.explanation_of(*cells[1:])
            self.check_explanation(cells[0], explanation)
            key = DistributionKey(cells[0], explanation.rule, explanation.values)
            value = key, explanation
        return value

    def check_state(self, state: State) -> None:
        """The problem must have all atoms."""
        try:
            self._atoms.check(state)
        except MeaningError as error:
            raise ValueError(str(error)) from None

    def check_action(self, action: GroundAction) -> None:
        """The problem must have the action, with these objects."""
        known = self._actions.get(action.action)
        if known is None:
            raise ValueError(f"`{action}`: there is no action `{action.action}`")
        if len(known.parameters) != len(action.arguments):
            raise ValueError(f"`{action}`: the action has {len(known.parameters)} parameters")
        for variable, name in zip(known.parameters, action.arguments, strict=True):
            if name not in self._objects:
                raise ValueError(f"`{action}`: there is no object `{name}`")
            if not any(name in self._members[each] for each in variable.types):
                types = " | ".join(variable.types)
                raise ValueError(f"`{action}`: object `{name}` is not of type {types}")

    def check_explanation(self, action: str, explanation: Explanation) -> None:
        """The rule must be there, and the weights must share one execution between its outcomes."""
        rule: Rule | None = self._rules.get((action, explanation.rule))
        if rule is None:
            raise ValueError(f"there is no rule `{action}.{explanation.rule}`")
        name = f"`{action}.{rule.name}`"
        values, weights = explanation.values, explanation.weights
        if len(values) != len(rule.per) or not all(
            isinstance(value, str) and value in self._objects for value in values
        ):
            raise ValueError(f"the values of rule {name} are not one object for each of its `per`")
        if len(weights) != len(rule.outcomes):
            raise ValueError(
                f"rule {name} has {len(rule.outcomes)} outcomes, and {len(weights)} weights are given"
            )
        if not all(
            isinstance(w, int | float) and not isinstance(w, bool) and 0.0 <= w <= 2.0
            for w in weights
        ) or not is_one(math.fsum(weights)):
            shown = ", ".join(str(w)[:20] for w in weights)
            raise ValueError(f"the weights of rule {name} are no shares that sum to 1: {shown}")


def damaged(name: object, what: object) -> StoreInputError:
    """The error for a store that holds what none can."""
    return StoreInputError(f"the store `{name}` is damaged: {what}")


def read_meta(name: object, meta: Mapping[str, Any]) -> dict[str, Any]:
    """What a store says of itself: `domain`, `problem`, `settings`, `seed` and `created`."""
    for key in ("domain", "problem", "settings", "seed", "created"):
        if not isinstance(meta.get(key), str):
            raise damaged(name, f"`{key}` is not in its table `meta`")
    found: dict[str, Any] = {"created": meta["created"]}
    try:
        found["domain"] = parse_text(meta["domain"], name="the domain").domain
        if found["domain"] is not None:
            document = parse_text(meta["problem"], found["domain"], name="the problem")
            found["problem"] = document.problem
    except InputError as error:
        first = error.diagnostics[0]
        raise damaged(name, f"the text of its domain or problem: {first.message}") from error
    for key in ("domain", "problem"):
        if found.get(key) is None:
            raise damaged(name, f"the text of its `{key}` holds none")
    for key, kind, wanted in (("settings", dict, "JSON object"), ("seed", int, "whole number")):
        try:
            found[key] = value = json.loads(meta[key])
        except (ValueError, RecursionError):
            value = ...
        if not isinstance(value, kind) and not (key == "seed" and value is None):
            raise damaged(name, f"its `{key}` is no {wanted}")
    return found


def check_environments(name: object, environments: list[tuple[Any, ...]], domain: Domain) -> None:
    """The table of environments must be the domain's."""
    there = {each[1]: each[2] for each in environments}
    wanted = {e.name: e.role for e in domain.all_environments}
    for each, role in wanted.items():
        if each not in there:
            raise damaged(name, f"environment `{each}` of its domain is not there")
        if there[each] != role:
            raise damaged(name, f"the role of environment `{each}` is not {role}")
    if len(there) > len(wanted):
        raise damaged(name, "it has an environment that is not in its domain")


def check_rows(
    name: object, connection: sqlite3.Connection, rows: Rows, keep: Callable[[str, int, Any], None]
) -> None:
    """Look at every row; ``keep`` gets what the rows beside the experiences hold, as it is read.

    Raises StoreInputError, which names the first experience that is wrong.
    """
    found = connection.execute(_FAULTS).fetchone()
    if found is not None:
        raise damaged(name, f"experience {found[0]}: {found[1]}")
    for table, (called, columns, uses) in _TABLES.items():
        for number, *cells in connection.execute(f"SELECT id, {columns} FROM {table}"):  # noqa: S608
            try:
                keep(table, number, rows.read(table, tuple(cells)))
            except ValueError as error:
                query = f"SELECT min(id) FROM experiences WHERE {uses}"  # noqa: S608
                (user,) = connection.execute(query, (number,)).fetchone()
                where = f"{called} {number}" if user is None else f"experience {user}"
                raise damaged(name, f"{where}: {error}") from error


def columns_of(table: str) -> str:
    """The columns of a table that `Rows.read` takes."""
    return _TABLES[table][1]
