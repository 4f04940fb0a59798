"""Policy files: a policy as JSON, written and read back.

::

    {
     "format": "menid policy 1",
     "domain": NAME, "problem": NAME, "environment": NAME, "params": {NAME: NUMBER, ...},
     "noise": "stay" or "sink", "objective": NAME, "status": NAME,
     "value": NUMBER, "lower": NUMBER, "upper": NUMBER,      or "inf", "-inf"; the first also null
     "horizon": NUMBER or null,
     "always": [ATOM, ...],                                  what holds in every state
     "states": [{"state": [ATOM, ...], "action": TEXT, "left": [LEAST, MOST]}, ...]
    }

``left`` stands in files of a finite horizon, and there in every entry: it is for so many steps left.
A range may run over numbers of steps with which the policy does not come to the state.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, NoReturn, TypeVar, get_args

from menid_plan.errors import InputError
from menid_plan.grounding.semantics import Noise
from menid_plan.grounding.state import GroundAction
from menid_plan.language.ground import read_action, read_state
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom
from menid_plan.policy import Entry, Policy, PolicyError
from menid_plan.solving import Objective, Status

FORMAT = "menid policy 1"

_KEYS = (
    "format", "domain", "problem", "environment", "params", "noise", "objective", "status", "value",
    "lower", "upper", "horizon", "always", "states",
)  # fmt: skip

_Value = TypeVar("_Value")


def number_json(value: float) -> float | str | None:
    """A float as JSON can hold it: infinities as words, NaN as null."""
    if math.isnan(value):
        return None
    return value if abs(value) != math.inf else ("inf" if value > 0 else "-inf")


def policy_text(policy: Policy) -> str:
    """A policy as the text of its file, one line for each entry."""
    head = {
        "format": FORMAT,
        "domain": policy.domain,
        "problem": policy.problem,
        "environment": policy.environment,
        "params": dict(policy.params),
        "noise": policy.noise,
        "objective": policy.objective,
        "status": policy.status,
        "value": number_json(policy.value),
        "lower": number_json(policy.lower),
        "upper": number_json(policy.upper),
        "horizon": policy.horizon,
        "always": sorted(map(str, policy.always)),
    }
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    entries = []
    for entry in policy.entries:
        shown: dict[str, Any] = {"state": sorted(map(str, entry.state))}
        shown["action"] = str(entry.action)
        if entry.left is not None:
            shown["left"] = list(entry.left)
        entries.append("  " + json.dumps(shown))
    listed = "[\n" + ",\n".join(entries) + "\n ]" if entries else "[]"
    return "{\n" + ",\n".join([*lines, f' "states": {listed}']) + "\n}\n"


def read_policy(text: str | bytes, domain: Domain, problem: Problem, name: str) -> Policy:
    """The policy that a file's text holds, for this domain and problem.

    ``name`` is what messages call the file. Raises PolicyError, which names the place: the key, or
    the number of the entry (from 1) and its atom or action.
    """
    return _Reader(domain, problem, name).policy(text)


class _Reader:
    """Reads one file; each distinct atom and action is parsed once."""

    def __init__(self, domain: Domain, problem: Problem, name: str) -> None:
        self.domain = domain
        self.problem = problem
        self.name = name
        self._atoms: dict[str, GroundAtom] = {}
        self._actions: dict[str, GroundAction] = {}

    def fail(self, message: str) -> NoReturn:
        raise PolicyError(f"`{self.name}`: {message}")

    def policy(self, text: str | bytes) -> Policy:
        data = self._data(text)
        self._identity(data)
        horizon = data["horizon"]
        if horizon != self.problem.horizon or isinstance(horizon, bool):
            self.fail(
                f"`horizon` is {json.dumps(horizon)}, and that of the problem is "
                f"{json.dumps(self.problem.horizon)}"
            )
        states = self._typed(data, "states", list, "a list of entries")
        always = self._typed(data, "always", list, "a list of atoms")
        self._learn_atoms([always, *(e.get("state") for e in states if isinstance(e, dict))])
        fixed = self._state("`always`", always)
        entries = tuple(
            self._entry(number, entry, fixed) for number, entry in enumerate(states, start=1)
        )
        self._disjoint(entries)
        value = math.nan if data["value"] is None else self._number(data, "value")
        lower, upper = self._number(data, "lower"), self._number(data, "upper")
        if lower > upper or not (math.isnan(value) or lower <= value <= upper):
            self.fail(
                "`value` and its bounds: `lower` must not be above `value`, nor that above `upper`"
            )
        return Policy(
            domain=self.domain.name,
            problem=self.problem.name,
            environment=self._one_of(
                data, "environment", [e.name for e in self.domain.all_environments]
            ),
            params=self._params(data),
            noise=self._one_of(data, "noise", get_args(Noise)),
            objective=self._one_of(data, "objective", get_args(Objective)),
            status=self._one_of(data, "status", get_args(Status)),
            value=value,
            lower=lower,
            upper=upper,
            horizon=horizon,
            always=fixed,
            entries=entries,
        )

    def _data(self, text: str | bytes) -> dict[str, Any]:
        try:
            data = json.loads(text, parse_constant=self._no_constant)
        except UnicodeDecodeError:
            self.fail("this is no UTF-8 text, and no policy")
        except json.JSONDecodeError as error:
            self.fail(f"line {error.lineno}, column {error.colno}: no JSON: {error.msg}")
        except (RecursionError, ValueError):
            self.fail("this is no policy: JSON that is nested too deep, or has a number too long")
        if not isinstance(data, dict):
            self.fail("this is no policy: the JSON is no object")
        missing = [key for key in _KEYS if key not in data]
        if "format" not in missing and data["format"] != FORMAT:
            self.fail(f"`format` is {json.dumps(data['format'])}, not {json.dumps(FORMAT)}")
        if missing:
            self.fail(f"this is no policy: `{missing[0]}` is missing")
        unknown = [key for key in data if key not in _KEYS]
        if unknown:
            self.fail(f"a policy has no `{unknown[0]}`")
        return data

    def _no_constant(self, name: str) -> NoReturn:
        self.fail(f"no JSON: `{name}`; infinities are written as words, NaN as null")

    def _identity(self, data: dict[str, Any]) -> None:
        for key, wanted in (("domain", self.domain.name), ("problem", self.problem.name)):
            if data[key] != wanted:
                self.fail(f"the policy is for the {key} {json.dumps(data[key])}, not `{wanted}`")

    def _typed(self, data: dict[str, Any], key: str, kind: type[_Value], what: str) -> _Value:
        value = data[key]
        if not isinstance(value, kind):
            self.fail(f"`{key}` is not {what}")
        return value

    def _one_of(self, data: dict[str, Any], key: str, known: Iterable[Any]) -> Any:
        known = list(known)
        if data[key] not in known:
            self.fail(f"`{key}` is {json.dumps(data[key])}, and not one of: {', '.join(known)}")
        return data[key]

    def _number(self, data: dict[str, Any], key: str) -> float:
        value = data[key]
        if value in ("inf", "-inf"):
            return float(value)
        number = math.nan
        if isinstance(value, int | float) and not isinstance(value, bool):
            with suppress(OverflowError):
                number = float(value)
        if math.isnan(number):
            self.fail(f"`{key}` is {json.dumps(value)}, not a number")
        return number

    def _params(self, data: dict[str, Any]) -> dict[str, float]:
        params = self._typed(data, "params", dict, "an object of numbers")
        known = {param.name for param in (*self.domain.params, *self.problem.params)}
        for key in params:
            if key not in known:
                self.fail(f"`params` has `{key}`, which is no param of the domain")
            if not math.isfinite(self._number(params, key)):
                self.fail(f"`params`: `{key}` is not finite")
        return {key: float(value) for key, value in params.items()}

    def _entry(self, number: int, entry: Any, always: frozenset[GroundAtom]) -> Entry:
        where = f"entry {number}"
        if not isinstance(entry, dict):
            self.fail(f"{where}: not an object")
        keys = ["state", "action"] + ["left"] * (self.problem.horizon is not None)
        for key in keys:
            if key not in entry:
                self.fail(f"{where}: `{key}` is missing")
        for key in entry:
            if key not in keys:
                why = ": the problem has no horizon" if key == "left" else ""
                self.fail(f"{where}: an entry has no `{key}`{why}")
        if not isinstance(entry["state"], list):
            self.fail(f"{where}: `state` is not a list of atoms")
        state = self._state(where, entry["state"])
        if state & always:
            self.fail(f"{where}: atom `{min(map(str, state & always))}` stands in `always` too")
        return Entry(state, self._action(where, entry["action"]), self._left(where, entry))

    def _left(self, where: str, entry: dict[str, Any]) -> tuple[int, int] | None:
        horizon = self.problem.horizon
        if horizon is None:
            return None
        left = entry["left"]
        fits = isinstance(left, list) and len(left) == 2 and all(type(n) is int for n in left)
        if not fits or not 1 <= left[0] <= left[1] <= horizon:
            self.fail(
                f"{where}: `left` is {json.dumps(left)}, and not the least and the most steps left, "
                f"between 1 and the horizon {horizon}"
            )
        return left[0], left[1]

    def _learn_atoms(self, lists: Iterable[Any]) -> None:
        """Parse what stands in the lists at once, if it is all right and written as we write."""
        texts = {text for found in lists if isinstance(found, list) for text in found
                 if isinstance(text, str)}  # fmt: skip
        try:
            atoms = read_state(",\n".join(texts), self.domain, self.problem, self.name)
        except InputError:
            return  # each is looked at by itself, where the place is known
        known = {str(atom): atom for atom in atoms}
        self._atoms = {text: known[text] for text in texts if text in known}

    def _state(self, where: str, texts: list[Any]) -> frozenset[GroundAtom]:
        state = set()
        for text in texts:
            if not isinstance(text, str):
                self.fail(f"{where}: {json.dumps(text)} is no atom")
            atom = self._atoms.get(text)
            if atom is None:
                read = self._read(f"{where}: atom `{text}`", self._one_atom, text)
                atom = self._atoms[text] = read
            if atom in state:
                self.fail(f"{where}: atom `{text}` stands twice in the state")
            state.add(atom)
        return frozenset(state)

    def _one_atom(self, text: str) -> GroundAtom | None:
        found = list(read_state(text, self.domain, self.problem, self.name))
        return found[0] if len(found) == 1 else None

    def _action(self, where: str, text: Any) -> GroundAction:
        if not isinstance(text, str):
            self.fail(f"{where}: {json.dumps(text)} is no action")
        if text not in self._actions:
            self._actions[text] = self._read(f"{where}: action `{text}`", self._one_action, text)
        return self._actions[text]

    def _one_action(self, text: str) -> GroundAction:
        return GroundAction(*read_action(text, self.domain, self.problem, self.name))

    def _read(self, what: str, read: Callable[[str], _Value | None], text: str) -> _Value:
        try:
            value = read(text)
        except InputError as error:
            self.fail(f"{what}: {error.diagnostics[0].message}")
        if value is None:
            self.fail(f"{what} is not one atom")
        return value

    def _disjoint(self, entries: tuple[Entry, ...]) -> None:
        """Refuse two entries for one state and number of steps left."""
        ranges: dict[frozenset[GroundAtom], list[tuple[int, int, int]]] = {}
        for number, entry in enumerate(entries, start=1):
            ranges.setdefault(entry.state, []).append((*(entry.left or (0, 0)), number))
        for found in ranges.values():
            found.sort()
            for (_, most, first), (least, _, second) in itertools.pairwise(found):
                if least <= most:
                    low, high = sorted((first, second))
                    self.fail(f"entry {high} is for a state of entry {low} again")
