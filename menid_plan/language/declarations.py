"""What a domain and a problem declare alike: objects and params, and the comments above them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from graphlib import CycleError, TopologicalSorter
from typing import Any

from menid_plan.language import syntax
from menid_plan.language.names import Names
from menid_plan.language.report import Report
from menid_plan.language.syntax import Token
from menid_plan.language.tokens import Comment
from menid_plan.model.domain import (
    Object,
)
from menid_plan.model.expressions import EvaluationError, Expression, evaluate, params_in
from menid_plan.source import SourceFile

# A range of objects may name this many.
MAX_RANGE = 100_000


class Documentation:
    """The comment lines that stand directly above a token."""

    def __init__(self, comments: Iterable[Comment], source: SourceFile) -> None:
        self._source = source
        self._before: dict[int, list[Comment]] = {}
        for comment in comments:
            if comment.own_line:
                self._before.setdefault(comment.before, []).append(comment)

    def __call__(self, token: Token) -> str:
        """The comment of the declaration, rule or row that starts with the token."""
        line = self._source.position(token.start)[0]
        lines: list[str] = []
        for comment in reversed(self._before.get(token.index, ())):
            if self._source.position(comment.start)[0] != line - 1:
                break
            text = comment.text[1:]
            lines.append(text[1:] if text.startswith(" ") else text)
            line -= 1
        return "\n".join(reversed(lines))


class Declarations:
    """Groups of objects, as constants of a domain or objects of a problem."""

    report: Report
    names: Names
    doc: Callable[[Token], str]
    first_objects: dict[str, Token]

    def objects(self, node: syntax.Constants | syntax.Objects, type_: str) -> list[Object]:
        """The objects of one declaration, which are added to the names."""
        attributes: dict[str, float] = {}
        for attribute in node.attributes:
            if attribute.name.value in attributes:
                self.report.duplicate("attribute", attribute.name, None)
            value = float(attribute.number.value)
            attributes[attribute.name.value] = -value if attribute.sign else value
        given = tuple(attributes.items())
        doc = self.doc(node.keyword)
        objects = []
        for item in node.names:
            span = self.report.span(item)
            token = item.last if isinstance(item, syntax.ObjectRange) else item
            for name in self._expand(item):
                if name in self.names.objects:
                    first = self.first_objects.get(name)
                    self.report.duplicate("object", _renamed(token, name), first)
                self.first_objects.setdefault(name, token)
                self.names.objects[name] = type_
                objects.append(Object(name, type_, given, doc, span))
        return objects

    def _expand(self, item: Token | syntax.ObjectRange) -> list[str]:
        if isinstance(item, Token):
            return [item.value]
        first, last = _numbered(item.first.value), _numbered(item.last.value)
        if first is None or last is None or first[0] != last[0]:
            self.report.error(
                "M305", "a range runs between two names that differ in a last whole number", item,
                "for example n1..n20; no leading zeros",
            )  # fmt: skip
            return []
        if last[1] < first[1]:
            self.report.error("M305", "a range ascends", item)
            first, last = last, first
        if len(self.names.objects) + last[1] - first[1] >= MAX_RANGE:
            message = f"ranges name at most {MAX_RANGE} objects in all"
            self.report.error("M305", message, item)
            return []
        return [f"{first[0]}{number}" for number in range(first[1], last[1] + 1)]


_NUMBERED = re.compile(r"(.*?)(0|[1-9][0-9]{0,17})", re.ASCII)


def _numbered(name: str) -> tuple[str, int] | None:
    """A name's prefix and number; None if it ends in no number without leading zeros."""
    match = _NUMBERED.fullmatch(name)
    return (match[1], int(match[2])) if match and not match[1][-1:].isdigit() else None


def _renamed(token: Token, name: str) -> Token:
    return Token(token.type, name, token.start, token.end, token.index)


def param_values_of(
    report: Report, expressions: dict[str, tuple[Expression, Any]]
) -> dict[str, float | None]:
    """The value of each param; None, and a report, for one that has none."""
    values: dict[str, float | None] = {}
    graph = {
        name: {p for p in params_in(expression) if p in expressions}
        for name, (expression, _) in expressions.items()
    }
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        cycle = list(reversed(error.args[1]))
        text = " -> ".join(cycle)
        report.error("M414", f"params depend on each other: {text}", expressions[cycle[0]][1])
        return dict.fromkeys(expressions)
    for name in order:
        expression, node = expressions[name]
        known = {p: values.get(p) for p in params_in(expression)}
        values[name] = None
        if all(value is not None for value in known.values()):
            try:
                values[name] = evaluate(
                    expression, {p: v for p, v in known.items() if v is not None}
                )
            except EvaluationError as error:
                report.error("M413", f"this expression has no value: {error}", node)
    return values
