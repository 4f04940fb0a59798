"""Relaxed reachability: which facts and rules can ever matter.

Every fact starts as it is in the initial state. Whatever some rule that may cover may do to it is
possible from then on, and nothing that was possible ever stops being so. What this finds impossible
is so in every reachable state; what it finds possible may not be.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from menid_plan.grounding.circuit import FALSE, TRUE, Circuit, Node, Signal
from menid_plan.grounding.instantiate import GroundEffect, GroundRule
from menid_plan.model.formulas import GroundAtom

_MAY_BE_TRUE, _MAY_BE_FALSE = 1, 2
_BOTH = _MAY_BE_TRUE | _MAY_BE_FALSE


@dataclass(frozen=True, slots=True)
class Pruned:
    """Rules and other signals over a circuit in which facts that never change are constants."""

    circuit: Circuit
    rules: list[GroundRule]
    signals: list[Signal]


def prune(
    circuit: Circuit,
    rules: Sequence[GroundRule],
    signals: Sequence[Signal],
    init: frozenset[GroundAtom],
) -> Pruned:
    """Leave out the rules that never cover, and the facts that never change.

    ``signals`` are further roots (the goal, rewards); they come back in their new form.
    """
    # A fact that only effects mention is in no condition; it is a state variable all the same.
    for rule in rules:
        for effects in rule.effects:
            for effect in effects:
                for atom in (*effect.add, *effect.delete):
                    circuit.fact(atom)
    reach = _Reachability(circuit, rules, init)
    new = _Rebuilt(circuit, reach)
    kept = []
    for rule in rules:
        condition = new.signal(rule.condition)
        if reach.possible(rule.condition) and condition != FALSE:
            changes = tuple(tuple(new.effects(outcome)) for outcome in rule.effects)
            kept.append(GroundRule(rule.action, rule.rule, rule.binding, condition, changes))
    return Pruned(new.circuit, kept, [new.signal(signal) for signal in signals])


class _Reachability:
    """What each node may be, as bits of _MAY_BE_TRUE and _MAY_BE_FALSE."""

    def __init__(
        self, circuit: Circuit, rules: Sequence[GroundRule], init: frozenset[GroundAtom]
    ) -> None:
        self.circuit = circuit
        self.may = [0] * len(circuit.nodes)
        # Nodes above a node, and whether they look at its negation.
        self._users: list[list[tuple[int, int]]] = [[] for _ in circuit.nodes]
        # How many operands may be true, how many may be false, and how many are surely true.
        self._can_be_true = [0] * len(circuit.nodes)
        self._can_be_false = [0] * len(circuit.nodes)
        self._is_true = [0] * len(circuit.nodes)
        self._watchers: list[list[int]] = [[] for _ in circuit.nodes]
        self._rules = rules
        facts: dict[GroundAtom, int] = {}
        for number in range(len(circuit.nodes)):
            for operand in circuit.operands(number):
                self._users[operand >> 1].append((number, operand & 1))
        for index, rule in enumerate(rules):
            for signal in {rule.condition, *(e.condition for o in rule.effects for e in o)}:
                self._watchers[signal >> 1].append(index)
        self._facts = facts
        self._set(0, _MAY_BE_FALSE)
        for number, node in enumerate(circuit.nodes):
            if node.kind == "fact" and node.atom is not None:
                facts[node.atom] = number
                self._set(number, _MAY_BE_TRUE if node.atom in init else _MAY_BE_FALSE)
        self._settle([*range(len(circuit.nodes))])
        queue = list(range(len(rules)))
        while queue:
            changed = [number for index in queue for number in self._fire(rules[index])]
            queue = sorted(self._settle(changed))

    def possible(self, signal: Signal) -> bool:
        """Whether a signal may be true."""
        return bool(self._may(signal) & _MAY_BE_TRUE)

    def _may(self, signal: Signal) -> int:
        return _signed(self.may[signal >> 1], signal & 1)

    def _set(self, number: int, new: int) -> None:
        """Change what a node may be, and what is known of the operands of the nodes above."""
        old = self.may[number]
        self.may[number] = new
        for user, negated in self._users[number]:
            before, after = _signed(old, negated), _signed(new, negated)
            self._can_be_true[user] += (after & 1) - (before & 1)
            self._can_be_false[user] += (after >> 1) - (before >> 1)
            self._is_true[user] += (after == _MAY_BE_TRUE) - (before == _MAY_BE_TRUE)

    def _settle(self, changed: Iterable[int]) -> set[int]:
        """Carry changes to the nodes above; the rules that look at any that changed."""
        seen: set[int] = set()
        stack = list(changed)
        for number in stack:
            seen.update(self._watchers[number])
        # Lower numbers first, so that a node is looked at when its operands are done.
        stack.sort(reverse=True)
        while stack:
            number = stack.pop()
            new = self.may[number] | self._evaluate(number)
            if new != self.may[number]:
                self._set(number, new)
                seen.update(self._watchers[number])
                stack.extend(user for user, _ in self._users[number])
            elif self.circuit.nodes[number].kind == "fact":
                stack.extend(user for user, _ in self._users[number])
        return seen

    def _evaluate(self, number: int) -> int:
        node = self.circuit.nodes[number]
        if node.kind == "all":
            true = self._can_be_true[number] == len(node.operands)
            false = self._can_be_false[number] > 0
            return true * _MAY_BE_TRUE | false * _MAY_BE_FALSE
        if node.kind == "count":
            most, least = self._can_be_true[number], self._is_true[number]
            if node.comparison == "=":
                true = least <= node.number <= most
                false = not least == most == node.number
            else:
                true, false = most >= node.number, least < node.number
            return true * _MAY_BE_TRUE | false * _MAY_BE_FALSE
        if node.kind == "derived":
            # Whether it is always true is another question, which is not asked.
            return self._may(self.circuit.definitions[number]) & _MAY_BE_TRUE | _MAY_BE_FALSE
        return self.may[number]

    def _fire(self, rule: GroundRule) -> list[int]:
        """What a rule that may cover makes possible; the facts for which that is new."""
        changed: list[int] = []
        if not self.possible(rule.condition):
            return changed
        for outcome in rule.effects:
            for effect in outcome:
                if self.possible(effect.condition):
                    for atoms, bit in ((effect.add, _MAY_BE_TRUE), (effect.delete, _MAY_BE_FALSE)):
                        for atom in atoms:
                            number = self._facts[atom]
                            if not self.may[number] & bit:
                                self._set(number, self.may[number] | bit)
                                changed.append(number)
        return changed


def _signed(may: int, negated: int) -> int:
    """What the negation of a node may be, or the node itself."""
    return ((may & 1) << 1 | may >> 1) if negated else may


class _Rebuilt:
    """A circuit again, with constants for what never changes."""

    def __init__(self, old: Circuit, reach: _Reachability) -> None:
        self.circuit = Circuit()
        self._old = old
        self._new: list[Signal] = []
        for number, node in enumerate(old.nodes):
            may = reach.may[number]
            if may != _BOTH:
                self._new.append(TRUE if may == _MAY_BE_TRUE else FALSE)
            else:
                self._new.append(self._node(node))
        for number, definition in old.definitions.items():
            signal = self._new[number]
            if signal > TRUE:
                self.circuit.definitions[signal >> 1] = self.signal(definition)

    def _node(self, node: Node) -> Signal:
        operands = [self.signal(operand) for operand in node.operands]
        if node.kind == "all":
            return self.circuit.conjunction(operands)
        if node.kind == "count":
            return self.circuit.count(operands, node.comparison, node.number)
        assert node.atom is not None
        return (
            self.circuit.fact(node.atom) if node.kind == "fact" else self.circuit.derived(node.atom)
        )

    def signal(self, signal: Signal) -> Signal:
        """The new form of an old signal."""
        return self._new[signal >> 1] ^ (signal & 1)

    def effects(self, effects: Iterable[GroundEffect]) -> list[GroundEffect]:
        """Effects that may happen and change something that may change."""
        found = []
        for effect in effects:
            condition = self.signal(effect.condition)
            add = tuple(atom for atom in effect.add if self._changes(atom))
            delete = tuple(atom for atom in effect.delete if self._changes(atom))
            if condition != FALSE and (add or delete):
                found.append(GroundEffect(condition, add, delete))
        return found

    def _changes(self, atom: GroundAtom) -> bool:
        return self.signal(self._old.fact(atom)) > TRUE
