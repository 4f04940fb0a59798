"""A problem as bit masks: packed states, ground rules, and the program for all that is derived.

A state is W words of 64 bits: a bit for each fact that changes, or, where that takes more than one
word, a number for facts that exclude each other (see `menid_plan.grounding.packing`). Behind them an
*extended* state has bits for what is computed from it: conditions that are no conjunction of what a
state holds (disjunctions, counts, recursive derived atoms). Everything that is asked of a state (where
a rule covers, where an effect happens, the goal) is then a *cube*: entries (word, mask, value), each of
which demands that ``extended[word] & mask == value``.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from menid_plan.errors import MeaningError
from menid_plan.grounding.circuit import FALSE, TRUE, Circuit, Signal
from menid_plan.grounding.exclusive import Group, exclusive_groups, positives, simplified
from menid_plan.grounding.instantiate import GroundEffect, GroundRule, Instantiation
from menid_plan.grounding.packing import WORD, Layout
from menid_plan.grounding.prune import prune
from menid_plan.grounding.state import GroundAction, State
from menid_plan.grounding.tables import Tables, rows
from menid_plan.grounding.watches import Demand, watches
from menid_plan.model.domain import Domain, Problem, param_values
from menid_plan.model.expressions import EvaluationError, Expression, evaluate
from menid_plan.model.formulas import GroundAtom
from menid_plan.model.graph import components
from menid_plan.model.rules import Rule

BESIDES = 0.5  # of a group's facts may need a bit besides; if more do, a number is no gain
FEW = WORD  # facts for which nobody asks whether some exclude each other: they fit in a word


@dataclass(frozen=True, slots=True)
class Distribution:
    """What one distribution over outcomes is for: a rule and the values of its `per` parameters.

    Its outcomes have the slots ``start``, ``start + 1``, ..., noise last.
    """

    action: str
    rule: Rule
    values: tuple[str, ...]
    start: int

    @property
    def slots(self) -> range:
        """The slots of its outcomes."""
        return range(self.start, self.start + len(self.rule.outcomes))

    def __str__(self) -> str:
        per = f" for {', '.join(self.values)}" if self.values else ""
        return f"{self.action}.{self.rule.name}{per}"


@dataclass(frozen=True, slots=True, eq=False)
class GroundProblem:
    """A problem grounded: names for the numbers in its tables.

    ``layout`` tells where states keep the facts that change; ``always`` are the atoms that hold in
    every reachable state. ``slot_reward`` (float64) is what each slot's outcome pays,
    ``action_cost`` what each action costs.
    """

    domain: Domain
    problem: Problem
    params: Mapping[str, float]
    layout: Layout
    always: frozenset[GroundAtom]
    actions: tuple[GroundAction, ...]
    rules: tuple[GroundRule, ...]
    distributions: tuple[Distribution, ...]
    rule_distribution: tuple[int, ...]
    initial: NDArray[np.uint64]
    slot_reward: NDArray[np.float64]
    action_cost: NDArray[np.float64]
    goal_reward: float
    dead_end_reward: float
    tables: Tables
    seconds: float

    @property
    def slots(self) -> int:
        """How many slots for probabilities there are."""
        return len(self.slot_reward)

    @property
    def facts(self) -> tuple[GroundAtom, ...]:
        """The atoms that change, sorted."""
        return self.layout.facts

    def pack(self, state: State) -> NDArray[np.uint64] | None:
        """A state as words; None if it is known that no step leads there."""
        changing = state - self.always
        if (
            len(state) - len(changing) < len(self.always)
            or not changing <= self.layout.places.keys()
        ):
            return None
        return self.layout.pack(changing)

    def unpack(self, words: NDArray[np.uint64]) -> State:
        """The state of some words, with the atoms that always hold."""
        return self.always.union(self.layout.unpack(words))


def ground(
    domain: Domain, problem: Problem, params: Mapping[str, float] | None = None
) -> GroundProblem:
    """Ground a problem; ``params`` sets params of the domain anew.

    Raises MeaningError for a param or reward without a value, LimitError if there is too much to do.
    """
    start = time.perf_counter()
    try:
        values = param_values(domain, problem, params)
    except EvaluationError as error:
        raise MeaningError(str(error)) from error
    work = Instantiation(domain, problem)
    rules = list(work.rules())
    rewards, signals = [], []
    for reward in domain.rewards:
        for signal in work.bound_signals(reward.variables, reward.condition):
            rewards.append(_value(reward.reward, values, "a reward of states"))
            signals.append(signal)
    goal = TRUE if problem.goal is None else work.signal(problem.goal, {})
    pruned = prune(work.circuit, rules, [goal, *signals], work.init)
    found, circuit = pruned.rules, pruned.circuit
    facts = tuple(sorted(node.atom for node in circuit.nodes if node.kind == "fact" and node.atom))
    groups: list[Group] = []
    if len(facts) > FEW:
        groups = exclusive_groups(circuit, found, work.init)
        found = simplified(circuit, found, groups)
    builder = _Builder(circuit, found, facts, groups)
    tables = builder.tables(
        pruned.signals[0] if problem.goal is not None else None, pruned.signals[1:], rewards
    )
    layout = builder.layout
    initial = layout.pack(work.init.intersection(facts))
    assert initial is not None
    costs = {
        action.name: _value(action.cost, values, f"the cost of action `{action.name}`")
        for action in domain.actions
    }
    slot_reward = [
        _value(outcome.reward, values, f"the reward of outcome `{outcome.name}`")
        for distribution in builder.distributions
        for outcome in distribution.rule.outcomes
    ]
    return GroundProblem(
        domain, problem, values, layout, work.init.difference(facts), tuple(builder.actions),
        tuple(found),
        tuple(builder.distributions), tuple(builder.rule_distribution), initial,
        np.array(slot_reward, np.float64),
        np.array([costs[action.action] for action in builder.actions], np.float64),
        _value(problem.goal_reward, values, "the goal's reward"),
        _value(problem.dead_end_reward, values, "the dead end's reward"),
        tables, time.perf_counter() - start,
    )  # fmt: skip


def _value(expression: Expression | None, params: Mapping[str, float], what: str) -> float:
    if expression is None:
        return 0.0
    try:
        return evaluate(expression, params)
    except EvaluationError as error:
        raise MeaningError(f"{what}: {error}") from error


_ALL = 2**64 - 1
_Rows: TypeAlias = list[tuple[int, ...]]
_Changes: TypeAlias = dict[int, tuple[int, int]]  # by word: the bits to delete, and those to add


class _Builder:
    """Numbers facts, actions and distributions, and fills the tables."""

    def __init__(
        self, circuit: Circuit, rules: list[GroundRule], facts: tuple[GroundAtom, ...],
        groups: Sequence[Group],
    ) -> None:  # fmt: skip
        self.circuit = circuit
        self.rules = rules
        self.layout = Layout(facts, groups)
        self.actions = list(dict.fromkeys(rule.action for rule in rules))
        self.distributions: list[Distribution] = []
        self.rule_distribution: list[int] = []
        self._number_distributions()
        self._bits: dict[int, int] = {}  # of the nodes that have a bit of their own
        self.entries: list[tuple[int, int, int]] = []
        self.outcome_masks: list[tuple[list[int], list[int]]] = []
        self._rule_demands: list[list[Demand]] = []
        self._effect_demands: list[list[list[Demand]]] = []

    def _number_distributions(self) -> None:
        known: dict[tuple[str, str, tuple[str, ...]], int] = {}
        start = 0
        for rule in self.rules:
            key = (rule.action.action, rule.rule.name, rule.values)
            if key not in known:
                known[key] = len(self.distributions)
                self.distributions.append(Distribution(key[0], rule.rule, rule.values, start))
                start += len(rule.rule.outcomes)
            self.rule_distribution.append(known[key])

    # ------------------------------------------------------------------------------- cubes

    def _code(self, number: int) -> tuple[int, int] | None:
        """The field of a node and its number there, if it is a fact of a group."""
        atom = (
            self.circuit.nodes[number].atom if self.circuit.nodes[number].kind == "fact" else None
        )
        return self.layout.code.get(atom) if atom is not None else None

    def _demands(self, condition: Signal) -> list[Demand]:
        """What has to hold where a conjunction does."""
        found = []
        for literal in self.circuit.literals(condition):
            if not literal & 1 and literal != FALSE:
                code = self._code(literal >> 1)
                found.append(Demand(code[1], code[0]) if code else Demand(self._bits[literal >> 1]))
        return found

    def _cube(self, condition: Signal) -> int:
        """Append the entries that demand a conjunction; the offset behind them."""
        masks: dict[int, tuple[int, int]] = {}
        for literal in self.circuit.literals(condition):
            if literal == FALSE:
                self.entries.append((0, 0, 1))  # nothing matches
                continue
            number, negated = literal >> 1, literal & 1
            atom = self.circuit.nodes[number].atom
            if atom is not None and not negated and self._code(number):
                word, more, wanted = self.layout.places[atom]
            else:
                word, bit = divmod(self._bits[number], WORD)
                more, wanted = 1 << bit, (1 - negated) << bit
            mask, value = masks.get(word, (0, 0))
            if mask & more:  # a field may be asked for two numbers, which it never holds
                self.entries.append((word, more, wanted))
                continue
            masks[word] = (mask | more, value | wanted)
        self.entries.extend((word, mask, value) for word, (mask, value) in masks.items())
        return len(self.entries)

    # --------------------------------------------------------------------------- the program

    def _program(self, roots: list[Signal]) -> list[list[int]]:
        """The nodes that need a bit of their own, in groups to be computed one after the other."""
        needed = self._needed(roots)
        few = [
            group
            for group in self.layout.groups
            if sum(self.circuit.fact(a) >> 1 in needed for a in group) <= BESIDES * len(group)
        ]
        if len(few) < len(self.layout.groups):
            self.layout = Layout(self.layout.facts, few)
            needed = self._needed(roots)
        for number, node in enumerate(self.circuit.nodes):
            if node.kind == "fact" and node.atom and node.atom not in self.layout.code:
                place = self.layout.places[node.atom]
                self._bits[number] = place.word * WORD + place.mask.bit_length() - 1
        groups = [self._in_order(set(group), needed) for group in components(needed)]
        bit = self.layout.words * WORD
        for group in groups:
            for number in group:
                self._bits[number] = bit
                bit += 1
        self.extended_words = -(-bit // WORD)
        return groups

    def _needed(self, roots: list[Signal]) -> dict[int, tuple[int, ...]]:
        """The nodes that need a bit of their own, each with those that it is made of."""
        found: dict[int, tuple[int, ...]] = {}
        stack = [number for root in roots for number in self._asked(self.circuit.literals(root))]
        while stack:
            number = stack.pop()
            if number not in found:
                found[number] = self._asked(*self._operands(number))
                stack.extend(found[number])
        return found

    def _operands(self, number: int) -> tuple[Sequence[Signal], bool]:
        """The literals that a node is made of, and whether it is their conjunction."""
        node = self.circuit.nodes[number]
        if node.kind == "derived":
            return self.circuit.literals(self.circuit.definitions[number]), True
        return node.operands, node.kind == "all"

    def _asked(self, literals: Iterable[Signal], conjunction: bool = True) -> tuple[int, ...]:
        """The nodes whose bits are asked for; conjunctions ask fields what number they hold."""
        found = []
        for literal in literals:
            number = literal >> 1
            is_fact = self.circuit.nodes[number].kind == "fact"
            if is_fact:
                is_asked = self._code(number) and (literal & 1 or not conjunction)
            else:
                is_asked = number > 0
            if is_asked:
                found.append(number)
        return tuple(found)

    def _in_order(self, group: Collection[int], needed: Mapping[int, Sequence[int]]) -> list[int]:
        """The nodes of a group such that each comes behind those that it is made of.

        Derived atoms that depend on each other come one after the other, each behind its definition.
        So a pass over the group finds atoms that follow from those found so far, from none upwards,
        and repeated passes end in the least model.
        """
        derived = [n for n in sorted(group) if self.circuit.nodes[n].kind == "derived"]
        order: dict[int, None] = {}
        for root in derived or sorted(group):
            stack = [(root, False)]
            while stack:
                number, behind = stack.pop()
                if behind:
                    order[number] = None
                elif number not in order:
                    stack.append((number, True))
                    stack += [(n, False) for n in needed[number] if n in group and n not in derived]
        return list(order)

    def tables(self, goal: Signal | None, conditions: list[Signal], rewards: list[float]) -> Tables:
        """All tables; ``goal`` and the ``conditions`` of ``rewards`` are signals of the circuit."""
        roots = [goal] if goal is not None else []
        roots += conditions
        for rule in self.rules:
            roots.append(rule.condition)
            roots += [effect.condition for outcome in rule.effects for effect in outcome]
        groups = self._program(roots)
        ops, literals, segments = self._filled_program(groups)
        rules, outcome_effects, effects, changes = self._filled_rules()
        noise = [o.is_noise for d in self.distributions for o in d.rule.outcomes]
        reward_entries, reward_values = [len(self.entries)], []
        for condition, reward in zip(conditions, rewards, strict=True):
            if condition and reward:
                reward_entries.append(self._cube(condition))
                reward_values.append(reward)
        begin = len(self.entries)
        goal_entries = [-1, -1] if goal is None else [begin, self._cube(goal)]
        fields = self.layout.fields
        numbers = {action: number for number, action in enumerate(self.actions)}
        return Tables(
            words=self.layout.words,
            extended_words=self.extended_words,
            entry=rows(3, self.entries, np.uint64),
            op=rows(3, ops, np.int32),
            literal=rows(2, literals, np.uint64),
            segment=rows(2, segments, np.int32),
            rule=rows(3, rules, np.uint32),
            rule_action=np.array([numbers[rule.action] for rule in self.rules], np.int32),
            slot_noise=np.array(noise, np.bool_),
            outcome_change=np.array(self.outcome_masks, np.uint64).reshape(
                -1, 2, self.layout.words
            ),
            outcome_effects=np.array(outcome_effects, np.uint32),
            effect=rows(2, effects, np.uint32),
            change=rows(3, changes, np.uint64),
            field=rows(3, [(f.word, f.shift, (1 << f.width) - 1) for f in fields], np.uint64),
            rule_watch=watches([self._rule_demands], self.extended_words, fields),
            effect_watch=watches(self._effect_demands, self.extended_words, fields),
            reward_entries=np.array(reward_entries, np.uint32),
            reward_value=np.array(reward_values, np.float64),
            goal_entries=np.array(goal_entries, np.int32),
        )

    def _filled_program(self, groups: list[list[int]]) -> tuple[_Rows, _Rows, _Rows]:
        """The rows of the program: operations, literals, segments."""
        ops, literals, segments = _Rows(), _Rows(), _Rows()
        for group in groups:
            loops = any(self.circuit.nodes[number].kind == "derived" for number in group)
            # One long run of operations that need no repeating is one segment.
            if loops or not segments or segments[-1][0]:
                segments.append((int(loops), len(ops)))
            for number in group:
                node = self.circuit.nodes[number]
                exactly = node.comparison == "="
                kind = {"derived": 3, "count": 1 if exactly else 2}.get(node.kind, 0)
                ops.append((kind, node.number, len(literals)))
                if node.kind == "fact":
                    literals += self._field_bits(number)
                else:
                    literals += self._literal_bits(*self._operands(number))
        ops.append((0, 0, len(literals)))
        segments.append((0, len(ops) - 1))
        return ops, literals, segments

    def _literal_bits(
        self, literals: Iterable[Signal], conjunction: bool
    ) -> Iterator[tuple[int, int]]:
        """The bits of literals, and what turns each into one of the literals."""
        for literal in literals:
            number, negated = literal >> 1, literal & 1
            if literal == FALSE:  # a bit and its opposite
                yield from ((0, 0), (0, _ALL))
            elif conjunction and not negated and self._code(number):
                yield from self._field_bits(number)
            else:
                yield self._bits[number], _ALL if negated else 0

    def _field_bits(self, number: int) -> list[tuple[int, int]]:
        """The bits of a fact's field, and what turns each into 1 where it holds the fact's number."""
        atom = self.circuit.nodes[number].atom
        assert atom is not None
        index, code = self.layout.code[atom]
        word, shift, width = self.layout.fields[index]
        return [(WORD * word + shift + i, 0 if code >> i & 1 else _ALL) for i in range(width)]

    def _filled_rules(self) -> tuple[_Rows, list[int], _Rows, _Rows]:
        """The rows of rules, the offsets of outcomes, the rows of effects and of their changes."""
        cubes = [len(self.entries)]
        for rule in self.rules:
            cubes.append(self._cube(rule.condition))
            self._rule_demands.append(self._demands(rule.condition))
        rules, effects, changes = _Rows(), _Rows(), _Rows()
        outcomes = list[int]()
        begin = len(self.entries)
        for rule, distribution, entries in zip(
            self.rules, self.rule_distribution, cubes[:-1], strict=True
        ):
            slot = self.distributions[distribution].start
            rules.append((entries, len(outcomes), slot))
            covered = positives(self.circuit, rule.condition)
            for ground_effects in rule.effects:
                outcomes.append(len(effects))
                masks = ([0] * self.layout.words, [0] * self.layout.words)
                self._effect_demands.append([])
                for condition, changed in self._changing(covered, ground_effects):
                    if condition == TRUE:
                        for word, bits in changed.items():
                            for mask, more in zip(masks, bits, strict=True):
                                mask[word] |= more
                        continue
                    self._effect_demands[-1].append(self._demands(condition))
                    effects.append((begin, len(changes)))
                    changes += [(word, *bits) for word, bits in changed.items()]
                    begin = self._cube(condition)
                self.outcome_masks.append(masks)
        rules.append((cubes[-1], len(outcomes), 0))
        outcomes.append(len(effects))
        effects.append((begin, len(changes)))
        return rules, outcomes, effects, changes

    def _changing(
        self, covered: Set[GroundAtom], effects: Iterable[GroundEffect]
    ) -> Iterator[tuple[Signal, _Changes]]:
        """Effects as conditions and what they change where a rule covers, and these facts hold.

        To delete a fact of a group is to empty its field where it holds that fact.
        """
        for effect in effects:
            condition, changes = effect.condition, _Changes()
            known = covered | positives(self.circuit, condition)
            holds = {self.layout.code[a][0]: a for a in known if a in self.layout.code}
            for atom in effect.add:
                word, mask, value = self.layout.places[atom]
                _change(changes, word, mask, value)
            for atom in effect.delete:
                word, mask, _ = self.layout.places[atom]
                index, _ = self.layout.code.get(atom, (-1, 0))
                if index < 0 or holds.get(index) == atom:
                    _change(changes, word, mask, 0)
                elif index not in holds:
                    both = self.circuit.conjunction([condition, self.circuit.fact(atom)])
                    yield both, {word: (mask, 0)}
            if changes:
                yield condition, changes


def _change(changes: _Changes, word: int, delete: int, add: int) -> None:
    before = changes.get(word, (0, 0))
    changes[word] = (before[0] | delete, before[1] | add)
