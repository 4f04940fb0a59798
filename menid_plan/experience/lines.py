"""Experiences as JSON lines: written for other programs, and read back with every value checked.

docs/experiences.md lists the keys. What is written and read back is equal.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, NoReturn, TypeVar

from menid_plan.errors import InputError
from menid_plan.experience.record import Experience, Explanation
from menid_plan.experience.schema import StoreInputError
from menid_plan.grounding.state import GroundAction, State
from menid_plan.language.ground import read_action, read_state
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom
from menid_plan.model.probabilities import is_one
from menid_plan.model.rules import Rule

KEYS = (
    "environment", "role", "number", "state", "action", "after", "reward", "duration", "seed", "when",
    "explanation",
)  # fmt: skip

_PARTS = ("rule", "values", "weights")

_Value = TypeVar("_Value")


class LineError(StoreInputError):
    """A line is no experience of a domain and problem; the message has its number and the key."""


def write_lines(domain: Domain, experiences: Iterable[Experience]) -> Iterator[str]:
    """One line of JSON for each experience, in order, each with its line feed."""
    roles = {e.name: e.role for e in domain.all_environments}
    rules = _rules_of(domain)
    states: dict[State, list[str]] = {}
    for seen in experiences:
        if len(states) > 10_000:
            states.clear()
        for state in (seen.state, seen.after):
            if state not in states:
                states[state] = [str(atom) for atom in sorted(state)]
        explanation = None
        if seen.explanation is not None:
            found = seen.explanation
            outcomes = rules[seen.action.action][found.rule].outcomes
            named = zip(outcomes, found.weights, strict=True)
            explanation = {
                "rule": found.rule,
                "values": list(found.values),
                "weights": {outcome.name: weight for outcome, weight in named if weight},
            }
        line = {
            "environment": seen.environment,
            "role": roles[seen.environment],
            "number": seen.number,
            "state": states[seen.state],
            "action": str(seen.action),
            "after": states[seen.after],
            "reward": seen.reward,
            "duration": seen.duration,
            "seed": seen.seed,
            "when": seen.when,
            "explanation": explanation,
        }
        yield json.dumps(line, allow_nan=False) + "\n"


def read_lines(
    lines: Iterable[str | bytes], domain: Domain, problem: Problem, name: str
) -> Iterator[Experience]:
    """The experiences of some lines, in order; empty lines are passed over.

    ``name`` is what messages call the text. Raises LineError at the first bad line.
    """
    reader = _Reader(domain, problem, name)
    for number, line in enumerate(lines, start=1):
        if line.strip():
            yield reader.experience(number, line)


class _Reader:
    """Reads the lines of one text; each distinct atom, state and action is parsed once."""

    def __init__(self, domain: Domain, problem: Problem, name: str) -> None:
        self.domain = domain
        self.problem = problem
        self.name = name
        self.line = 0
        self._roles = {e.name: e.role for e in domain.all_environments}
        self._rules = _rules_of(domain)
        self._objects = {o.name for o in (*domain.constants, *problem.objects)}
        self._atoms: dict[str, GroundAtom] = {}
        self._actions: dict[str, GroundAction] = {}
        self._states: dict[tuple[str, ...], State] = {}

    def fail(self, message: str) -> NoReturn:
        raise LineError(f"`{self.name}`, line {self.line}: {message}")

    def experience(self, number: int, line: str | bytes) -> Experience:
        self.line = number
        data = self._data(line)
        environment = data["environment"]
        if not isinstance(environment, str) or environment not in self._roles:
            known = ", ".join(self._roles)
            self.fail(f"`environment` is {_shown(environment)}, and not one of: {known}")
        role = self._roles[environment]
        if data["role"] != role:
            self.fail(f"`role` is {_shown(data['role'])}, and that of `{environment}` is {role}")
        action = self._action(data["action"])
        reward = data["reward"]
        return Experience(
            environment=environment,
            state=self._state("state", data["state"]),
            action=action,
            after=self._state("after", data["after"]),
            reward=None if reward is None else self._number("reward", reward),
            duration=self._number("duration", data["duration"], least=0.0),
            seed=self._whole("seed", data["seed"]),
            when=self._number("when", data["when"]),
            explanation=self._explanation(action, data["explanation"]),
            number=self._whole("number", data["number"], least=0, most=2**63 - 1),
        )

    # ------------------------------------------------------------------------------ JSON and numbers

    def _data(self, line: str | bytes) -> dict[str, Any]:
        try:
            data = json.loads(line, object_pairs_hook=self._object)
        except UnicodeDecodeError:
            self.fail("this is no UTF-8 text")
        except json.JSONDecodeError as error:
            self.fail(f"column {error.colno}: no JSON: {error.msg}")
        except (RecursionError, ValueError):
            self.fail("JSON that is nested too deep, or has a number too long")
        if not isinstance(data, dict):
            self.fail("the JSON is no object")
        self._has_keys(data, KEYS, "an experience")
        return data

    def _object(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        """An object; a key that stands twice would hide a value."""
        data = dict(pairs)
        if len(data) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            self.fail(f"`{twice}` stands twice")
        return data

    def _has_keys(self, data: Mapping[str, Any], keys: Collection[str], what: str) -> None:
        for key in keys:
            if key not in data:
                self.fail(f"`{key}` is missing")
        for key in data:
            if key not in keys:
                self.fail(f"{what} has no `{key}`")

    def _number(self, key: str, value: Any, least: float = -math.inf) -> float:
        number = math.nan
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                number = float(value)
            except OverflowError:
                number = math.inf
        if not math.isfinite(number) or number < least:
            wanted = "a finite number" + (f" >= {least:g}" if least > -math.inf else "")
            self.fail(f"`{key}` is {_shown(value)}, not {wanted}")
        return number

    def _whole(self, key: str, value: Any, least: float = -math.inf, most: float = math.inf) -> int:
        if type(value) is not int or not least <= value <= most:
            wanted = "a whole number" + (f" >= {least:g}" if least > -math.inf else "")
            self.fail(f"`{key}` is {_shown(value)}, not {wanted}")
        return value

    # ------------------------------------------------------------------------------ atoms and actions

    def _state(self, key: str, texts: Any) -> State:
        if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
            self.fail(f"`{key}` is no list of atoms, each in quotes")
        known = tuple(texts)
        found = self._states.get(known)
        if found is None:
            atoms = [self._atom(key, text) for text in texts]
            found = frozenset(atoms)
            if len(found) < len(atoms):
                twice = next(atom for atom in atoms if atoms.count(atom) > 1)
                self.fail(f"`{key}`: atom `{twice}` stands twice")
            if len(self._states) > 10_000:
                self._states.clear()
            self._states[known] = found
        return found

    def _atom(self, key: str, text: str) -> GroundAtom:
        if text not in self._atoms:
            found = self._read(
                f"`{key}`: atom `{text}`",
                lambda: list(read_state(text, self.domain, self.problem, self.name)),
            )
            if len(found) != 1:
                self.fail(f"`{key}`: `{text}` is not one atom")
            self._atoms[text] = found[0]
        return self._atoms[text]

    def _action(self, text: Any) -> GroundAction:
        if not isinstance(text, str):
            self.fail(f"`action` is {_shown(text)}, not an action in quotes")
        if text not in self._actions:
            self._actions[text] = self._read(
                f"`action`: `{text}`",
                lambda: GroundAction(*read_action(text, self.domain, self.problem, self.name)),
            )
        return self._actions[text]

    def _read(self, what: str, read: Callable[[], _Value]) -> _Value:
        try:
            return read()
        except InputError as error:
            self.fail(f"{what}: {error.diagnostics[0].message}")

    # ----------------------------------------------------------------------------------- explanations

    def _explanation(self, action: GroundAction, data: Any) -> Explanation | None:
        if data is None:
            return None
        if not isinstance(data, dict):
            self.fail("`explanation` is neither null nor an object")
        self._has_keys(data, _PARTS, "an explanation")
        name = data["rule"]
        rules = self._rules[action.action]
        if not isinstance(name, str) or name not in rules:
            known = ", ".join(rules)
            self.fail(f"`rule` is {_shown(name)}, and not one of `{action.action}`: {known}")
        rule = rules[name]
        return Explanation(
            name, self._values(rule, action, data["values"]), self._weights(rule, data["weights"])
        )

    def _values(self, rule: Rule, action: GroundAction, values: Any) -> tuple[str, ...]:
        parameters = self.domain.action(action.action).parameters
        objects = dict(zip((v.name for v in parameters), action.arguments, strict=True))
        wanted = [objects[name] for name in rule.per]
        if values != wanted:
            self.fail(
                f"`values` is {_shown(values)}, and those of rule `{rule.name}` in `{action}` are "
                f"{_shown(wanted)}"
            )
        return tuple(wanted)

    def _weights(self, rule: Rule, data: Any) -> tuple[float, ...]:
        if not isinstance(data, dict):
            self.fail("`weights` is no object of numbers")
        names = [outcome.name for outcome in rule.outcomes]
        for name in data:
            if name not in names:
                self.fail(f"`weights`: rule `{rule.name}` has no outcome `{name}`")
        weights = [self._number(f"weights.{n}", data.get(n, 0.0), least=0.0) for n in names]
        if not is_one(math.fsum(weights)):
            self.fail(f"`weights` sum to {math.fsum(weights):g}, not 1")
        return tuple(weights)


def _rules_of(domain: Domain) -> dict[str, dict[str, Rule]]:
    return {action.name: {rule.name: rule for rule in action.rules} for action in domain.actions}


def _shown(value: Any) -> str:
    """A value as JSON, cut if it is long."""
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
