"""What an RDDL text means, by pyRDDLGym: every state and transition that its CPFs lead to."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from pyRDDLGym.core.compiler.model import RDDLLiftedModel, RDDLPlanningModel
from pyRDDLGym.core.parser.parser import RDDLParser
from pyRDDLGym.core.parser.reader import RDDLReader
from pyRDDLGym.core.simulator import RDDLSimulator

from menid_plan.exchange.rddl import Written
from menid_plan.grounding.state import GroundAction
from menid_plan.model.formulas import GroundAtom

# The values of all state fluents, and what is executed: the name of an action fluent, its objects.
Values: TypeAlias = tuple[tuple[str, bytes], ...]
Act: TypeAlias = tuple[str, tuple[str, ...]] | None
Row: TypeAlias = tuple[float, dict[Values, float]]


@cache
def parser() -> RDDLParser:
    """A parser; its tables are not left behind in files."""
    made = RDDLParser(lexer=None, verbose=False)
    made.build(debug=False, write_tables=False)
    return made


class Simulator(RDDLSimulator):  # type: ignore[misc]
    """Draws what it is told to, and keeps how probable that was."""

    def __init__(self, model: RDDLLiftedModel) -> None:
        super().__init__(model)
        self.script: list[int] = []
        self.drawn: list[tuple[int, int, float]] = []

    def choose(self, chances: list[float]) -> int:
        place = len(self.drawn)
        possible = [i for i, chance in enumerate(chances) if chance > 0]
        number = self.script[place] if place < len(self.script) else 0
        self.drawn.append((number, len(possible), chances[possible[number]]))
        return possible[number]

    def _sample_discrete_helper(self, pdf: Any, unnorm: bool, expr: Any) -> Any:
        super()._sample_discrete_helper(pdf, unnorm, expr)  # checks it
        assert np.ndim(pdf) == 1
        return np.int64(self.choose(list(pdf)))

    def _sample_bernoulli(self, expr: Any, subs: Any) -> Any:
        chance = float(self._sample(expr.args[0], subs))
        return np.bool_(self.choose([1.0 - chance, chance]))


@dataclass
class Rddl:
    """A domain and an instance as pyRDDLGym has them."""

    written: Written
    folder: Path
    horizon: int = 0
    discount: float = 1.0
    rows: dict[Values, dict[Act, Row]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        domain, instance = self.folder / "domain.rddl", self.folder / "instance.rddl"
        domain.write_text(self.written.domain, encoding="utf-8")
        instance.write_text(self.written.instance, encoding="utf-8")
        with redirect_stdout(StringIO()):
            text = RDDLReader(domain, instance).rddltxt
            self.model = RDDLLiftedModel(parser().parse(text))
            self.simulator = Simulator(self.model)
        self.horizon, self.discount = self.model.horizon, self.model.discount
        self.simulator.reset()
        self.start = dict(self.simulator.subs)
        self.initial = self.values()
        self.acts: list[Act] = [None, *self._acts()]

    def _acts(self) -> Iterator[Act]:
        for name in self.model.action_fluents:
            types = self.model.variable_params[name]
            for objects in itertools.product(*(self.model.type_to_objects[t] for t in types)):
                yield name, objects

    def values(self) -> Values:
        subs = self.simulator.subs
        return tuple((name, np.asarray(subs[name]).tobytes()) for name in self.model.state_fluents)

    def put(self, values: Values) -> None:
        self.simulator.subs = dict(self.start)
        for name, data in values:
            like = np.asarray(self.start[name])
            self.simulator.subs[name] = np.frombuffer(data, like.dtype).reshape(like.shape)

    def prepared(self, act: Act) -> dict[str, Any]:
        given = {}
        if act is not None:
            name, objects = act
            given[RDDLPlanningModel.ground_var(name, objects)] = True
        found: dict[str, Any] = self.simulator.prepare_actions_for_sim(given)
        return found

    def row(self, values: Values, act: Act) -> Row | None:
        """The reward and the states after an action; None if it is not legal."""
        actions = self.prepared(act)
        self.put(values)
        if not self.simulator.check_action_preconditions(actions, silent=True):
            return None
        after: dict[Values, float] = {}
        mean = 0.0
        self.simulator.script = []
        while True:
            self.put(values)
            self.simulator.drawn = []
            _, reward, done = self.simulator.step(actions)
            assert not done
            chance = float(np.prod([chance for _, _, chance in self.simulator.drawn]))
            now = self.values()
            after[now] = after.get(now, 0.0) + chance
            mean += chance * reward
            script = [(number, number_of) for number, number_of, _ in self.simulator.drawn]
            while script and script[-1][0] + 1 == script[-1][1]:
                script.pop()
            if not script:
                return mean, after
            self.simulator.script = [number for number, _ in script]
            self.simulator.script[-1] += 1

    def explore(self) -> None:
        """Fill ``rows`` with all that can be reached."""
        waiting = [self.initial]
        self.rows = {self.initial: {}}
        while waiting:
            values = waiting.pop()
            for act in self.acts:
                row = self.row(values, act)
                if row is None:
                    continue
                self.rows[values][act] = row
                for each in row[1]:
                    if each not in self.rows:
                        self.rows[each] = {}
                        waiting.append(each)

    def value(self) -> float:
        """The most that can be expected, by backward induction over the instance's horizon."""
        best = dict.fromkeys(self.rows, 0.0)
        for _ in range(self.horizon):
            best = {
                values: max(
                    reward + self.discount * sum(p * best[each] for each, p in after.items())
                    for reward, after in rows.values()
                )
                for values, rows in self.rows.items()
            }
        return best[self.initial]

    # ------------------------------------------------------------------- in terms of the problem

    def flag(self, values: Values, key: str) -> bool:
        name = self.written.names.get(key)
        data = dict(values).get(name or "")
        return data is not None and any(data)

    def facts(self, values: Values) -> frozenset[GroundAtom]:
        """The facts that change and hold."""
        objects = {name: each for each, name in self.written.objects.items()}
        found = set()
        data = dict(values)
        for fact, name in self.written.facts.items():
            types = self.model.variable_params[name]
            array = np.frombuffer(data[name], bool)
            if isinstance(fact, GroundAtom):
                if array[0]:
                    found.add(fact)
                continue
            tuples = itertools.product(*(self.model.type_to_objects[t] for t in types))
            for holds, arguments in zip(array, tuples, strict=True):
                if holds:
                    found.add(GroundAtom(fact, tuple(objects[each] for each in arguments)))
        return frozenset(found)

    def action(self, act: Act) -> GroundAction:
        assert act is not None
        objects = {name: each for each, name in self.written.objects.items()}
        parameters, call = self.written.actions[act[0]]
        return call.bound(dict(zip(parameters, (objects[each] for each in act[1]), strict=True)))
