"""What a policy does, as a graph to be drawn: its decisions, where they lead, and how probably.

A node is a decision: a state with the action that is taken there (and, with a horizon, the numbers of
steps left for which it is). States where an episode ends are nodes too, and so is the horizon. Where
it depends on the steps left to which decision an outcome leads, its edges say for which they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from menid_plan.errors import LimitError
from menid_plan.grounding.state import SINK
from menid_plan.mdp.explore import Structure
from menid_plan.mdp.model import MDP
from menid_plan.model.formulas import GroundAtom
from menid_plan.policy import decisions, known_value
from menid_plan.solving import Solution

MAX_NODES = 60

# If a state has more facts to be shown than that, what differs from the initial state is shown.
_FACTS = 6
_SHOWN = 8


@dataclass(frozen=True, slots=True)
class Node:
    """A state in the lines of ``state`` and what is done there (empty: an episode ends).

    ``left`` is the range of steps left in words, or empty; ``end`` is ``goal``, ``dead end``,
    ``sink``, ``horizon``, ``no action``, or empty. ``value`` is the best of the state by the objective,
    the middle of its bounds; NaN where an episode ends or with less than all steps of a horizon left.
    """

    state: tuple[str, ...]
    action: str = ""
    left: str = ""
    end: str = ""
    initial: bool = False
    value: float = math.nan


@dataclass(frozen=True, slots=True)
class Edge:
    """What may come of a decision: outcomes with their probabilities, by numbers of nodes.

    ``left`` is the range of steps left in words in which it may, or empty: whenever it is taken.
    """

    source: int
    target: int
    outcomes: tuple[tuple[str, float], ...]
    left: str = ""

    @property
    def probability(self) -> float:
        """Of all its outcomes."""
        return sum(chance for _, chance in self.outcomes)

    @property
    def lines(self) -> tuple[str, ...]:
        """When it may be, and each outcome with its probability, but for the only way to go."""
        when = (f"{self.left}:",) if self.left else ()
        if len(self.outcomes) == 1 and self.probability == 1.0:
            return tuple(line.rstrip(":") for line in when)
        return (*when, *(f"{name} {chance:.3g}" for name, chance in self.outcomes))


@dataclass(frozen=True, slots=True)
class Drawing:
    """A graph with a title; the first node is the initial state."""

    title: str
    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]


def drawing_of(structure: Structure, mdp: MDP, solution: Solution) -> Drawing:
    """The graph of what a solution's policy comes to; LimitError if it has over MAX_NODES nodes."""
    return _Graph(structure, mdp, solution).drawing()


@dataclass(slots=True)
class _Found:
    """A node on its way: its state's number, and the row that is taken."""

    state: int
    row: int = -1
    least: int = 0
    most: int = 0
    edges: dict[int, dict[str, float]] = field(default_factory=dict)


class _Graph:
    def __init__(self, structure: Structure, mdp: MDP, solution: Solution) -> None:
        self.structure = structure
        self.mdp = mdp
        self.solution = solution
        found = decisions(mdp, solution)
        self._demand(len(found.state))
        columns = (c.tolist() for c in (found.state, found.row, found.least, found.most))
        self.nodes = [_Found(*each) for each in zip(*columns, strict=True)]
        first = [n for n in self.nodes if n.state == mdp.initial and n.most == (mdp.horizon or 0)]
        if first:  # with the most steps left
            self.nodes.remove(first[0])
            self.nodes.insert(0, first[0])
        self._by_state: dict[int, list[int]] = {}
        for number, node in enumerate(self.nodes):
            self._by_state.setdefault(node.state, []).append(number)
        if not self.nodes:
            self._end(mdp.initial)
        self._horizon = -1
        for node in self.nodes[:]:
            self._follow(node)
        self._demand(len(self.nodes))

    @staticmethod
    def _demand(number: int) -> None:
        if number > MAX_NODES:
            raise LimitError(
                f"the policy comes to {number} states and more, and at most {MAX_NODES} are drawn"
                if number == MAX_NODES + 1
                else f"the policy comes to {number} states, and at most {MAX_NODES} are drawn"
            )

    def _follow(self, node: _Found) -> None:
        if node.row < 0:
            return
        structure, mdp = self.structure, self.mdp
        rule = int(structure.row_rule[node.row])
        problem = structure.problem
        distribution = problem.distributions[problem.rule_distribution[rule]]
        names = [outcome.name for outcome in distribution.rule.outcomes]
        first, last = mdp.row_transition[node.row : node.row + 2].tolist()
        slots = structure.slot(np.arange(first, last)).tolist()
        chances = mdp.row_probabilities(node.row).tolist()
        for entry, slot, chance in zip(range(first, last), slots, chances, strict=True):
            if chance == 0.0:
                continue
            name = names[slot - distribution.start]
            for target in self._targets(node, int(mdp.next_state[entry])):
                outcomes = node.edges.setdefault(target, {})
                outcomes[name] = outcomes.get(name, 0.0) + chance

    def _targets(self, node: _Found, state: int) -> Iterator[int]:
        """The nodes to which a step into a state leads."""
        mdp = self.mdp
        if mdp.goal[state] or mdp.state_row[state] == mdp.state_row[state + 1]:
            yield self._end(state)
            return
        known = self._by_state.get(state, [])
        if mdp.horizon is None:
            yield known[0] if known else self._end(state)
            return
        for number in known:
            other = self.nodes[number]
            least, most = self._when(node, other)
            if other.row >= 0 and least <= most:
                yield number
        if node.least == 1:
            if self._horizon < 0:
                self._horizon = len(self.nodes)
                self.nodes.append(_Found(-1))
            yield self._horizon

    def _when(self, node: _Found, target: _Found) -> tuple[int, int]:
        """The steps left with which a decision leads to a node (none: the first is the larger)."""
        if target.state < 0:
            return 1, 1
        if target.row < 0:
            return node.least, node.most
        return max(node.least, target.least + 1), min(node.most, target.most + 1)

    def _end(self, state: int) -> int:
        if state not in self._by_state:
            self._by_state[state] = [len(self.nodes)]
            self.nodes.append(_Found(state))
        return self._by_state[state][0]

    def drawing(self) -> Drawing:
        """All nodes and edges, with their texts."""
        labels = self._labels()
        nodes = tuple(self._node(node, labels) for node in self.nodes)
        edges = tuple(
            Edge(source, target, tuple(outcomes.items()), self._edge_left(node, self.nodes[target]))
            for source, node in enumerate(self.nodes)
            for target, outcomes in node.edges.items()
        )
        problem, solution = self.structure.problem, self.solution
        value = known_value(solution)
        shown = "not known" if math.isnan(value) else f"{value:.6g}"
        return Drawing(
            f"{problem.domain.name}, {problem.problem.name}: {solution.objective} {shown}",
            nodes,
            edges,
        )

    def _edge_left(self, node: _Found, target: _Found) -> str:
        """The steps left with which an edge may be taken, unless it always may."""
        if self.mdp.horizon is None:
            return ""
        least, most = self._when(node, target)
        return "" if (least, most) == (node.least, node.most) else _left(least, most)

    def _node(self, node: _Found, labels: dict[int, tuple[str, ...]]) -> Node:
        mdp = self.mdp
        if node.state < 0:
            return Node((), end="horizon")
        if node.row < 0:
            end = "no action"
            if mdp.goal[node.state]:
                end = "goal"
            elif node.state == self.structure.sink:
                end = "sink"
            elif self.structure.dead_end[node.state]:
                end = "dead end"
            elif mdp.horizon == 0:
                end = "horizon"
            initial = node.state == mdp.initial
            return Node(labels[node.state], end=end, initial=initial)
        left = ""
        if mdp.horizon is not None:
            left = _left(node.least, node.most)
        action = str(self.structure.action(node.row))
        initial = node is self.nodes[0]
        value = math.nan
        if mdp.horizon is None or node.most == mdp.horizon:
            value = self.solution.value_of(node.state)
        return Node(labels[node.state], action, left, initial=initial, value=value)

    def _labels(self) -> dict[int, tuple[str, ...]]:
        """The text of each state: those facts that differ among the states that are drawn."""
        states: dict[int, frozenset[GroundAtom]] = {}
        for number in {node.state for node in self.nodes if node.state >= 0}:
            state = self.structure.state(number)
            if state is not SINK:
                states[number] = state
        every = frozenset.union(*states.values())
        differing = every - frozenset.intersection(*states.values())
        shown = {number: sorted(map(str, state & differing)) for number, state in states.items()}
        first = states[self.mdp.initial]
        if max(map(len, shown.values())) > _FACTS:
            shown = {
                number: [f"- {atom}" for atom in sorted(map(str, first - state))]
                + [f"+ {atom}" for atom in sorted(map(str, state - first))]
                for number, state in states.items()
            }
            none = "as in the beginning"
        else:
            none = "none of these" if len(differing) != 1 else f"not {next(iter(differing))}"
        labels = {number: _cut(facts) or (none,) for number, facts in shown.items()}
        return {self.structure.sink: (), **labels}


def _left(least: int, most: int) -> str:
    """A range of steps left in words."""
    return f"{least} left" if least == most else f"{least} to {most} left"


def _cut(facts: list[str]) -> tuple[str, ...]:
    if len(facts) <= _SHOWN:
        return tuple(facts)
    return (*facts[: _SHOWN - 1], f"and {len(facts) - _SHOWN + 1} more")


def dot_text(drawing: Drawing) -> str:
    """A drawing in the DOT language of Graphviz."""
    lines = [
        "digraph policy {",
        f"  label={_quoted(drawing.title)}; labelloc=t; rankdir=LR;",
        '  node [shape=box, style="rounded,filled", fillcolor=white, fontname="Helvetica"];',
        '  edge [fontname="Helvetica", fontsize=10];',
        "  start [shape=point];",
    ]
    for number, node in enumerate(drawing.nodes):
        text = [*node.state]
        text += [f"[{node.action}]"] if node.action else []
        text += [node.left] if node.left else []
        text += [node.end] if node.end and (node.end != "goal" or not node.state) else []
        look = ""
        if node.end == "goal":
            look = ", peripheries=2, fillcolor=honeydew"
        elif node.end:
            look = ", fillcolor=gray85"
        lines.append(f"  n{number} [label={_quoted(*text)}{look}];")
        if node.initial:
            lines.append(f"  start -> n{number};")
    for edge in drawing.edges:
        label = f" [label={_quoted(*edge.lines)}]" if edge.lines else ""
        lines.append(f"  n{edge.source} -> n{edge.target}{label};")
    return "\n".join([*lines, "}"]) + "\n"


def _quoted(*lines: str) -> str:
    """Lines as a string of DOT."""
    escaped = (line.replace("\\", "\\\\").replace('"', '\\"') for line in lines)
    return '"' + "\\n".join(escaped) + '"'
