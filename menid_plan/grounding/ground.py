"""A problem as bit masks: packed states, ground rules, and the program for all that is derived.

A state is W words of 64 bits, one bit for each fact that changes. Behind them an *extended* state has
bits for what is computed from it: conditions that are no conjunction of bits (disjunctions, counts,
recursive derived atoms). Everything that is asked of a state (where a rule covers, where an effect
happens, the goal) is then a *cube*: entries (word, mask, value), each of which demands that
``extended[word] & mask == value``.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from menid_plan.errors import MeaningError
from menid_plan.grounding.circuit import FALSE, TRUE, Circuit, Signal
from menid_plan.grounding.instantiate import GroundRule, Instantiation
from menid_plan.grounding.prune import prune
from menid_plan.grounding.state import GroundAction, State
from menid_plan.grounding.tables import Columns, Tables
from menid_plan.grounding.watches import watches
from menid_plan.model.domain import Domain, Problem, param_values
from menid_plan.model.expressions import EvaluationError, Expression, evaluate
from menid_plan.model.formulas import GroundAtom
from menid_plan.model.graph import components
from menid_plan.model.rules import Rule

WORD = 64


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

    ``facts[i]`` is the atom of bit i; ``always`` are the atoms that hold in every reachable state.
    ``slot_reward`` (float64) is what each slot's outcome pays, ``action_cost`` what each action costs.
    """

    domain: Domain
    problem: Problem
    params: Mapping[str, float]
    facts: tuple[GroundAtom, ...]
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

    def pack(self, state: State) -> NDArray[np.uint64]:
        """A state as words; atoms that never change are left out."""
        words = np.zeros(self.tables.words, np.uint64)
        for bit, atom in enumerate(self.facts):
            if atom in state:
                words[bit // WORD] |= np.uint64(1 << bit % WORD)
        return words

    def unpack(self, words: NDArray[np.uint64]) -> State:
        """The state of some words, with the atoms that always hold."""
        found = set(self.always)
        for index, word in enumerate(words.tolist()):
            while word:
                low = word & -word
                found.add(self.facts[index * WORD + low.bit_length() - 1])
                word ^= low
        return frozenset(found)


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
    except KeyError as error:
        raise MeaningError(f"there is no param `{error.args[0]}`") from error
    work = Instantiation(domain, problem)
    rules = list(work.rules())
    rewards, signals = [], []
    for reward in domain.rewards:
        for signal in work.bound_signals(reward.variables, reward.condition):
            rewards.append(_value(reward.reward, values, "a reward of states"))
            signals.append(signal)
    goal = TRUE if problem.goal is None else work.signal(problem.goal, {})
    pruned = prune(work.circuit, rules, [goal, *signals], work.init)
    builder = _Builder(pruned.circuit, pruned.rules)
    tables = builder.tables(
        pruned.signals[0] if problem.goal is not None else None, pruned.signals[1:], rewards
    )
    facts = tuple(builder.facts)
    always = work.init.difference(facts)
    costs = {
        action.name: _value(action.cost, values, f"the cost of action `{action.name}`")
        for action in domain.actions
    }
    slot_reward = [
        _value(outcome.reward, values, f"the reward of outcome `{outcome.name}`")
        for distribution in builder.distributions
        for outcome in distribution.rule.outcomes
    ]
    initial = np.zeros(tables.words, np.uint64)
    for bit, atom in enumerate(facts):
        if atom in work.init:
            initial[bit // WORD] |= np.uint64(1 << bit % WORD)
    return GroundProblem(
        domain, problem, values, facts, always, tuple(builder.actions), tuple(pruned.rules),
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


class _Builder:
    """Numbers facts, actions and distributions, and fills the tables."""

    def __init__(self, circuit: Circuit, rules: list[GroundRule]) -> None:
        self.circuit = circuit
        self.rules = rules
        self.facts = sorted(n.atom for n in circuit.nodes if n.kind == "fact" and n.atom)
        self.actions = list(dict.fromkeys(rule.action for rule in rules))
        self.distributions: list[Distribution] = []
        self.rule_distribution: list[int] = []
        self._number_distributions()
        self.words = max(1, -(-len(self.facts) // WORD))
        self._bits = {
            number: self._fact_bits()[node.atom]
            for number, node in enumerate(circuit.nodes)
            if node.kind == "fact" and node.atom is not None
        }
        self.entries: list[tuple[int, int, int]] = []
        self.outcome_masks: list[NDArray[np.uint64]] = []
        self._rule_bits: list[list[int]] = []
        self._effect_bits: list[list[list[int]]] = []

    def _fact_bits(self) -> dict[GroundAtom, int]:
        if not hasattr(self, "_by_fact"):
            self._by_fact = {atom: bit for bit, atom in enumerate(self.facts)}
        return self._by_fact

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

    def _literals(self, signal: Signal) -> list[Signal]:
        """The signals whose conjunction a signal is."""
        node = self.circuit.nodes[signal >> 1]
        if node.kind == "all" and not signal & 1:
            return list(node.operands)
        return [] if signal == TRUE else [signal]

    def _positive_bits(self, condition: Signal) -> list[int]:
        """The bits that have to be set where a conjunction holds."""
        literals = self._literals(condition)
        return [self._bits[li >> 1] for li in literals if not li & 1 and li != TRUE]

    def _cube(self, literals: list[Signal]) -> int:
        """Append the entries that demand these signals; the offset behind them."""
        masks: dict[int, tuple[int, int]] = {}
        for literal in literals:
            if literal == FALSE:
                self.entries.append((0, 0, 1))  # nothing matches
                continue
            word, bit = divmod(self._bits[literal >> 1], WORD)
            mask, value = masks.get(word, (0, 0))
            if mask >> bit & 1:  # a count may have one operand twice
                self.entries.append((word, 1 << bit, (~literal & 1) << bit))
                continue
            masks[word] = (mask | 1 << bit, value | (~literal & 1) << bit)
        self.entries.extend((word, mask, value) for word, (mask, value) in masks.items())
        return len(self.entries)

    # --------------------------------------------------------------------------- the program

    def _program(self, roots: list[Signal]) -> list[list[int]]:
        """The nodes that need a bit of their own, in groups to be computed one after the other."""
        needed: dict[int, tuple[int, ...]] = {}
        stack = [literal >> 1 for root in roots for literal in self._literals(root)]
        while stack:
            number = stack.pop()
            if number in needed or self.circuit.nodes[number].kind == "fact":
                continue
            below: list[int] = []
            for operand in self.circuit.operands(number):
                literals = [operand]
                if self.circuit.nodes[number].kind == "derived":
                    literals = self._literals(operand)
                below.extend(
                    li >> 1 for li in literals if self.circuit.nodes[li >> 1].kind != "fact"
                )
            needed[number] = tuple(n for n in below if n)
            stack.extend(needed[number])
        groups = [self._in_order(set(group), needed) for group in components(needed)]
        bit = self.words * WORD
        for group in groups:
            for number in group:
                self._bits[number] = bit
                bit += 1
        self.extended_words = -(-bit // WORD)
        return groups

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
        table = Columns()
        self._fill_program(groups, table)
        self._fill_rules(table)
        table.start("reward_entries", len(self.entries))
        for condition, reward in zip(conditions, rewards, strict=True):
            if condition and reward:
                table.add(reward_entries=self._cube(self._literals(condition)), reward_value=reward)
        begin = len(self.entries)
        goal_entries = [-1, -1]
        if goal is not None:
            goal_entries = [begin, self._cube(self._literals(goal))]
        outcome_masks = np.array(self.outcome_masks, np.uint64).reshape(-1, 2, self.words)
        words, masks, values = zip(*self.entries, strict=True) if self.entries else ((), (), ())
        return Tables(
            words=self.words,
            extended_words=self.extended_words,
            entry_word=np.array(words, np.int32),
            entry_mask=np.array(masks, np.uint64),
            entry_value=np.array(values, np.uint64),
            goal_entries=np.array(goal_entries, np.int32),
            rule_watch=watches([self._rule_bits], self.extended_words),
            effect_watch=watches(self._effect_bits, self.extended_words),
            outcome_delete=np.ascontiguousarray(outcome_masks[:, 0]),
            outcome_add=np.ascontiguousarray(outcome_masks[:, 1]),
            **table.arrays(),
        )

    def _fill_program(self, groups: list[list[int]], table: Columns) -> None:
        for name in ("op_literals", "segment_ops"):
            table.start(name, 0)
        ops = literals = 0
        for group in groups:
            loops = any(self.circuit.nodes[number].kind == "derived" for number in group)
            for number in group:
                node = self.circuit.nodes[number]
                operands = list(node.operands)
                if node.kind == "derived":
                    operands = self._literals(self.circuit.definitions[number])
                for bit, flip in self._literal_bits(operands):
                    table.add(literal_bit=bit, literal_flip=flip)
                    literals += 1
                exactly = node.comparison == "="
                kind = {"derived": 3, "count": 1 if exactly else 2}.get(node.kind, 0)
                table.add(op_kind=kind, op_number=node.number, op_literals=literals)
            ops += len(group)
            # One long run of operations that need no repeating is one segment.
            if not loops and table.last("segment_loops") == 0:
                table.drop("segment_ops", "segment_loops")
            table.add(segment_ops=ops, segment_loops=int(loops))

    def _literal_bits(self, literals: list[Signal]) -> Iterator[tuple[int, int]]:
        """The bit of each literal, and what turns it into the literal."""
        for literal in literals:
            if literal == FALSE:  # a bit and its opposite
                yield from ((0, 0), (0, _ALL))
            else:
                yield self._bits[literal >> 1], _ALL if literal & 1 else 0

    def _fill_rules(self, table: Columns) -> None:
        numbers = {action: number for number, action in enumerate(self.actions)}
        table.start("rule_entries", len(self.entries))
        for rule in self.rules:
            table.add(
                rule_entries=self._cube(self._literals(rule.condition)),
                rule_action=numbers[rule.action],
            )
            self._rule_bits.append(self._positive_bits(rule.condition))
        for name in ("rule_outcomes", "outcome_effects", "effect_changes"):
            table.start(name, 0)
        table.start("effect_entries", len(self.entries))
        outcomes = effects = changes = 0
        for rule, distribution in zip(self.rules, self.rule_distribution, strict=True):
            slots = self.distributions[distribution].slots
            for slot, outcome, ground_effects in zip(
                slots, rule.rule.outcomes, rule.effects, strict=True
            ):
                always = [effect for effect in ground_effects if effect.condition == TRUE]
                masks = np.zeros((2, self.words), np.uint64)
                for effect in always:
                    for word, bits in self._changes(effect.delete, effect.add).items():
                        masks[:, word] |= np.array(bits, np.uint64)
                self.outcome_masks.append(masks)
                self._effect_bits.append([])
                for effect in ground_effects:
                    if effect.condition == TRUE:
                        continue
                    self._effect_bits[-1].append(self._positive_bits(effect.condition))
                    for word, (delete, add) in self._changes(effect.delete, effect.add).items():
                        table.add(change_word=word, change_delete=delete, change_add=add)
                        changes += 1
                    end = self._cube(self._literals(effect.condition))
                    table.add(effect_entries=end, effect_changes=changes)
                    effects += 1
                table.add(
                    outcome_slot=slot, outcome_noise=int(outcome.is_noise), outcome_effects=effects
                )
                outcomes += 1
            table.add(rule_outcomes=outcomes)

    def _changes(
        self, delete: tuple[GroundAtom, ...], add: tuple[GroundAtom, ...]
    ) -> dict[int, tuple[int, int]]:
        """By word: the bits to delete and to add."""
        found: dict[int, tuple[int, int]] = {}
        for atoms, position in ((delete, 0), (add, 1)):
            for atom in atoms:
                word, bit = divmod(self._fact_bits()[atom], WORD)
                masks = list(found.get(word, (0, 0)))
                masks[position] |= 1 << bit
                found[word] = (masks[0], masks[1])
        return found
