"""Facts of which at most one ever holds, and what conditions become once that is known.

A group is proven as a fact-alternating mutex group (Fišer and Komenda, 2018): at most one of it holds
in the beginning, and an effect that adds one of its facts happens only where one of them holds, which
it deletes. Candidates are the facts of a predicate with some arguments fixed, such as all places of one
thing; where an effect adds without deleting, what it does delete is taken in (Helmert, 2009): a thing
lies somewhere, or it is held.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple, TypeAlias

from menid_plan.grounding.circuit import FALSE, TRUE, Circuit, Signal
from menid_plan.grounding.instantiate import GroundEffect, GroundRule
from menid_plan.model.formulas import GroundAtom

Group: TypeAlias = tuple[GroundAtom, ...]
_Template: TypeAlias = tuple[str, tuple[str | None, ...]]  # a predicate; None for any argument

LEAST = 3  # facts that are worth a group: they need two bits
MOST_TEMPLATES = 4
MOST_LOOKS = 20  # at each effect on average, after which no more groups are sought
MOST_OPERANDS = 64  # of a condition within a condition that is looked into
DEEPEST = 3  # conditions within conditions that are looked into


class _Adding(NamedTuple):
    """An effect that adds facts: what holds where it happens, and what is deleted there."""

    outcome: int
    known: frozenset[GroundAtom]
    delete: frozenset[GroundAtom]


def exclusive_groups(
    circuit: Circuit, rules: Sequence[GroundRule], init: frozenset[GroundAtom]
) -> list[Group]:
    """Groups of facts, no fact in two of them, such that at most one fact of a group ever holds."""
    return _Search(circuit, rules, init).groups()


def positives(circuit: Circuit, signal: Signal) -> frozenset[GroundAtom]:
    """The facts that hold wherever a conjunction does, as far as its operands tell."""
    nodes = (circuit.nodes[li >> 1] for li in circuit.literals(signal) if not li & 1)
    return frozenset(node.atom for node in nodes if node.kind == "fact" and node.atom)


class _Search:
    """Looks for groups among the facts of ground rules."""

    def __init__(
        self, circuit: Circuit, rules: Sequence[GroundRule], init: frozenset[GroundAtom]
    ) -> None:
        self.init = init
        self.facts = {node.atom for node in circuit.nodes if node.kind == "fact" and node.atom}
        self._adding: dict[GroundAtom, list[_Adding]] = {}
        self._matching: dict[tuple[str, tuple[int, ...]], dict[tuple[str, ...], list[GroundAtom]]]
        self._matching = {}
        self._by_predicate: dict[tuple[str, int], list[GroundAtom]] = {}
        for atom in sorted(self.facts):
            self._by_predicate.setdefault((atom.predicate, len(atom.arguments)), []).append(atom)
        self._tried: set[tuple[_Template, ...]] = set()
        self._looks = 0
        outcome = 0
        for rule in rules:
            covered = positives(circuit, rule.condition)
            for effects in rule.effects:
                always = [e for e in effects if e.condition == TRUE]
                deleted = frozenset(atom for effect in always for atom in effect.delete)
                for effect in effects:
                    known = covered | positives(circuit, effect.condition)
                    found = _Adding(outcome, known, deleted.union(effect.delete))
                    for atom in effect.add:
                        self._adding.setdefault(atom, []).append(found)
                outcome += 1
        self._most_looks = MOST_LOOKS * sum(map(len, self._adding.values()))

    def groups(self) -> list[Group]:
        """The largest groups first, the later ones of what those before have left."""
        found: set[frozenset[GroundAtom]] = set()
        covered: set[GroundAtom] = set()
        for seed in self._seeds():
            if not covered.issuperset(self._facts(seed)):
                for facts in self._grown(seed):
                    found.add(facts)
                    covered |= facts
        taken: set[GroundAtom] = set()
        groups = []
        for facts in sorted(found, key=lambda facts: (-len(facts), sorted(facts))):
            rest = facts - taken
            if len(rest) >= LEAST:
                groups.append(tuple(sorted(rest)))
                taken |= rest
        return groups

    def _seeds(self) -> Iterator[_Template]:
        """Predicates with some of their arguments fixed, as the facts have them."""
        for predicate, count in self._by_predicate:
            for free in range(count, -1, -1):
                for places in combinations(range(count), count - free):
                    for values in self._matches(predicate, count, places):
                        yield _template(predicate, count, places, values)

    def _grown(self, seed: _Template) -> Iterator[frozenset[GroundAtom]]:
        """The group of a template, or of it and others that are taken in."""
        fixed = {name for name in seed[1] if name is not None}
        waiting: list[tuple[_Template, ...]] = [(seed,)]
        while waiting and self._looks <= self._most_looks:
            templates = waiting.pop()
            if templates in self._tried:
                continue
            self._tried.add(templates)
            facts = frozenset(atom for template in templates for atom in self._facts(template))
            if len(facts & self.init) > 1:
                continue
            missing = self._missing(facts)
            if missing is None:
                if len(facts) >= LEAST:
                    yield facts
                    return
                continue
            for atom in sorted(missing):
                arguments = tuple(name if name in fixed else None for name in atom.arguments)
                larger = _together(templates, (atom.predicate, arguments))
                if len(larger) <= MOST_TEMPLATES:
                    waiting.append(larger)

    def _missing(self, facts: frozenset[GroundAtom]) -> frozenset[GroundAtom] | None:
        """None if the facts are a group; else some of which one more might make them one."""
        added: dict[tuple[int, GroundAtom], GroundAtom] = {}
        for fact in facts:
            adding = self._adding.get(fact, [])
            self._looks += len(adding)
            for effect in adding:
                before = facts & effect.known
                if not before:
                    return effect.known & effect.delete
                if len(before) > 1:
                    continue  # it never happens
                (was,) = before
                if was != fact and was not in effect.delete:
                    return frozenset()
                if added.setdefault((effect.outcome, was), fact) != fact:
                    return frozenset()  # two effects of an outcome, with a fact each
        return None

    def _facts(self, template: _Template) -> list[GroundAtom]:
        predicate, arguments = template
        places = tuple(place for place, name in enumerate(arguments) if name is not None)
        values = tuple(name for name in arguments if name is not None)
        return self._matches(predicate, len(arguments), places).get(values, [])

    def _matches(
        self, predicate: str, count: int, places: tuple[int, ...]
    ) -> dict[tuple[str, ...], list[GroundAtom]]:
        """The facts of a predicate by the values of some of their arguments."""
        key = (f"{predicate}/{count}", places)
        if key not in self._matching:
            index: dict[tuple[str, ...], list[GroundAtom]] = {}
            for atom in self._by_predicate.get((predicate, count), []):
                values = tuple(atom.arguments[place] for place in places)
                index.setdefault(values, []).append(atom)
            self._matching[key] = index
        return self._matching[key]


def _template(
    predicate: str, count: int, places: tuple[int, ...], values: tuple[str, ...]
) -> _Template:
    fixed = dict(zip(places, values, strict=True))
    return predicate, tuple(fixed.get(place) for place in range(count))


def _together(templates: tuple[_Template, ...], another: _Template) -> tuple[_Template, ...]:
    """Templates and another one, in order, less those that it includes."""
    apart = (each for each in templates if not _includes(another, each))
    return tuple(sorted((*apart, another), key=repr))


def _includes(general: _Template, special: _Template) -> bool:
    return (
        general[0] == special[0]
        and len(general[1]) == len(special[1])
        and all(g is None or g == s for g, s in zip(general[1], special[1], strict=True))
    )


# ----------------------------------------------------------------------------- simpler conditions


def simplified(
    circuit: Circuit, rules: Iterable[GroundRule], groups: Sequence[Group]
) -> list[GroundRule]:
    """The rules with conditions that are the same in every reachable state, but simpler.

    Where one fact of a group holds all others do not. So `the c: cell where at(c)` needs no count.
    """
    work = _Simplifier(circuit, groups)
    found = []
    for rule in rules:
        condition = work.under(rule.condition, {})
        if condition != FALSE:
            known = work.known(condition)
            effects = tuple(tuple(work.effects(outcome, known)) for outcome in rule.effects)
            found.append(GroundRule(rule.action, rule.rule, rule.binding, condition, effects))
    return found


class _Simplifier:
    """Conditions where it is known which fact of some groups holds; by the numbers of their nodes."""

    def __init__(self, circuit: Circuit, groups: Sequence[Group]) -> None:
        self.circuit = circuit
        self.group = {
            circuit.fact(atom) >> 1: number for number, group in enumerate(groups) for atom in group
        }
        self._sorted: dict[int, tuple[int, dict[int, list[Signal]]] | None] = {}

    def known(self, condition: Signal) -> dict[int, int]:
        """Of the groups of which a conjunction demands a fact: the node of that fact."""
        return {
            self.group[li >> 1]: li >> 1
            for li in self.circuit.literals(condition)
            if not li & 1 and li >> 1 in self.group
        }

    def effects(
        self, effects: Iterable[GroundEffect], known: Mapping[int, int]
    ) -> Iterator[GroundEffect]:
        """Effects where a rule covers."""
        for effect in effects:
            condition = self.under(effect.condition, known)
            if condition != FALSE:
                yield GroundEffect(condition, effect.add, effect.delete)

    def under(self, signal: Signal, known: Mapping[int, int], depth: int = 0) -> Signal:
        """A signal, simpler, where these facts hold."""
        own = self.known(signal)
        demanded = [li for li in self.circuit.literals(signal) if not li & 1]
        if sum(li >> 1 in self.group for li in demanded) > len(own):
            return FALSE  # two facts of a group
        if any(known.get(group, node) != node for group, node in own.items()):
            return FALSE
        both = {**known, **own}
        if not both:
            return signal
        parts = []
        for literal in self.circuit.literals(signal):
            if literal >> 1 in self.group and not literal & 1:
                parts.append(TRUE if self.group[literal >> 1] in known else literal)
            else:
                parts.append(self._part(literal, both, depth))
        return self.circuit.conjunction(parts)

    def _part(self, literal: Signal, known: Mapping[int, int], depth: int) -> Signal:
        number, negated = literal >> 1, literal & 1
        node = self.circuit.nodes[number]
        if node.kind == "fact":
            holds = known.get(self.group.get(number, -1))
            return literal if holds is None else int(holds == number) ^ negated
        if depth == DEEPEST:
            return literal
        if node.kind == "all" and len(node.operands) <= MOST_OPERANDS:
            return self.under(number << 1, known, depth + 1) ^ negated
        if node.kind == "count":
            by_fact = self._operands_by_fact(number)
            if by_fact is not None and by_fact[0] in known:
                rest = by_fact[1].get(known[by_fact[0]], [])
                rest = [self.under(literal, known, depth + 1) for literal in rest]
                return self.circuit.count(rest, node.comparison, node.number) ^ negated
        return literal

    def _operands_by_fact(self, number: int) -> tuple[int, dict[int, list[Signal]]] | None:
        """A group such that every operand of a count demands a fact of it, and which do which."""
        if number not in self._sorted:
            operands = self.circuit.nodes[number].operands
            each = [self.known(operand) for operand in operands]
            common = set(each[0]).intersection(*each[1:])
            found = None
            if common:
                group = min(common)
                by_fact: dict[int, list[Signal]] = {}
                for operand, known in zip(operands, each, strict=True):
                    by_fact.setdefault(known[group], []).append(operand)
                found = group, by_fact
            self._sorted[number] = found
        return self._sorted[number]
