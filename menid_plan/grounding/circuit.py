"""Ground formulas as a circuit: shared nodes over facts, simplified as they are made.

A *signal* is a node or its negation: twice the node's number, plus one if negated. FALSE and TRUE are
the two signals of node 0. Equal nodes are one node, and an operand has a lower number than the node
that uses it, except through the nodes of recursive derived atoms, whose definitions come later.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from operator import eq, ge, gt, le, lt, ne
from typing import Literal, NamedTuple, TypeAlias

from menid_plan.model.formulas import Comparison, GroundAtom

Signal: TypeAlias = int

FALSE: Signal = 0
TRUE: Signal = 1

_COMPARE = {"=": eq, "!=": ne, "<": lt, "<=": le, ">": gt, ">=": ge}


class Node(NamedTuple):
    """A node of a circuit.

    ``constant``: false. ``fact``: whether ``atom`` holds. ``all``: every operand is true. ``count``:
    how many operands are true, compared with ``number``. ``derived``: a recursive derived atom.
    """

    kind: Literal["constant", "fact", "all", "count", "derived"]
    atom: GroundAtom | None = None
    operands: tuple[Signal, ...] = ()
    comparison: Comparison = "="
    number: int = 0


@dataclass(slots=True)
class Circuit:
    """Nodes by number, and the definitions of the recursive derived atoms among them."""

    nodes: list[Node] = field(default_factory=lambda: [Node("constant")])
    definitions: dict[int, Signal] = field(default_factory=dict)
    _numbers: dict[Node, int] = field(default_factory=dict)

    def fact(self, atom: GroundAtom) -> Signal:
        """Whether a basic atom holds."""
        return self._signal(Node("fact", atom))

    def derived(self, atom: GroundAtom) -> Signal:
        """Whether a recursive derived atom holds; its definition is set in ``definitions``."""
        return self._signal(Node("derived", atom))

    def conjunction(self, operands: Iterable[Signal]) -> Signal:
        """Whether all operands are true."""
        flat: set[Signal] = set()
        for operand in operands:
            node = self.nodes[operand >> 1]
            if operand == FALSE:
                return FALSE
            if node.kind == "all" and not operand & 1:
                flat.update(node.operands)
            elif operand != TRUE:
                flat.add(operand)
        if any(operand ^ 1 in flat for operand in flat):
            return FALSE
        if len(flat) < 2:
            return flat.pop() if flat else TRUE
        return self._signal(Node("all", None, tuple(sorted(flat))))

    def disjunction(self, operands: Iterable[Signal]) -> Signal:
        """Whether any operand is true."""
        return self.conjunction(operand ^ 1 for operand in operands) ^ 1

    def count(self, operands: Sequence[Signal], comparison: Comparison, number: int) -> Signal:
        """Whether so many operands are true; one that stands twice counts twice."""
        known = sum(operand == TRUE for operand in operands)
        open_ = sorted(operand for operand in operands if operand > TRUE)
        compare, rest = _COMPARE[comparison], number - known
        answers = {compare(true, rest) for true in range(len(open_) + 1)}
        if len(answers) == 1:
            return TRUE if answers.pop() else FALSE
        at_least = {">": rest + 1, ">=": rest, "<": rest, "<=": rest + 1}.get(comparison)
        turned = comparison in ("<", "<=", "!=")
        if at_least == 1 or (at_least is None and rest == 0):
            found = self.disjunction(open_)
            return found ^ (at_least is None) ^ turned
        if at_least == len(open_) or (at_least is None and rest == len(open_)):
            return self.conjunction(open_) ^ turned
        if at_least is None:
            return self._signal(Node("count", None, tuple(open_), "=", rest)) ^ turned
        return self._signal(Node("count", None, tuple(open_), ">=", at_least)) ^ turned

    def _signal(self, node: Node) -> Signal:
        number = self._numbers.get(node)
        if number is None:
            number = self._numbers[node] = len(self.nodes)
            self.nodes.append(node)
        return number << 1

    def literals(self, signal: Signal) -> tuple[Signal, ...]:
        """The signals whose conjunction a signal is."""
        node = self.nodes[signal >> 1]
        if node.kind == "all" and not signal & 1:
            return node.operands
        return () if signal == TRUE else (signal,)

    def operands(self, number: int) -> tuple[Signal, ...]:
        """The signals that a node is made of; of a recursive derived atom, its definition."""
        node = self.nodes[number]
        return (self.definitions[number],) if node.kind == "derived" else node.operands
