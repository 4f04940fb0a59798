"""Strongly connected components."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import TypeVar

_Node = TypeVar("_Node", bound=Hashable)


def components(graph: Mapping[_Node, Sequence[_Node]]) -> Iterator[list[_Node]]:
    """Tarjan's strongly connected components, those that others depend on first.

    The recursion is a list, for there may be more predicates in a chain than Python recurses.
    """
    index: dict[_Node, int] = {}
    low: dict[_Node, int] = {}
    open_nodes: list[_Node] = []
    is_open: set[_Node] = set()
    for root in graph:
        path = [] if root in index else [(root, iter(graph[root]))]
        while path:
            node, successors = path[-1]
            if node not in index:
                index[node] = low[node] = len(index)
                open_nodes.append(node)
                is_open.add(node)
            for successor in successors:
                if successor not in index:
                    path.append((successor, iter(graph[successor])))
                    break
                if successor in is_open:
                    low[node] = min(low[node], index[successor])
            else:
                path.pop()
                if path:
                    low[path[-1][0]] = min(low[path[-1][0]], low[node])
                if low[node] == index[node]:
                    component = _pop_through(open_nodes, node)
                    is_open.difference_update(component)
                    yield component


def _pop_through(stack: list[_Node], last: _Node) -> list[_Node]:
    start = len(stack) - 1
    while stack[start] != last:
        start -= 1
    popped = stack[start:]
    del stack[start:]
    return popped
