"""Which columns of probabilities a rule has, and whether they are distributions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from menid_plan.model.domain import Domain
from menid_plan.model.expressions import ZERO, EvaluationError, Expression, evaluate
from menid_plan.model.rules import Action, Block, Rule
from menid_plan.model.text import expression_text, number_text
from menid_plan.source import Span

# How far from 1 the sum of a column may be.
TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Column:
    """One written distribution of a rule: where it stands and its cells, noise last.

    ``environment`` is empty for the single column that serves every environment; ``block`` is None
    for a column of the outcome table itself.
    """

    environment: str
    block: Block | None
    cells: tuple[Expression, ...]

    @property
    def values(self) -> tuple[str, ...]:
        """The values of the rule's `per` parameters for which the column is; empty: for all."""
        return self.block.values if self.block else ()


def columns(rule: Rule) -> Iterator[Column]:
    """Every column of probabilities that is written in a rule."""
    if rule.has_column:
        for index, environment in enumerate(rule.environments or ("",)):
            cells = tuple(o.cells[index] if o.cells else ZERO for o in rule.outcomes)
            yield Column(environment, None, cells)
    for block in rule.probabilities:
        for environment in block.environments:
            yield Column(environment, block, block.column(environment, rule.outcomes))


def is_one(total: float) -> bool:
    """Whether a column's sum is 1 within TOLERANCE (and what rounding adds to it)."""
    return abs(total - 1) <= TOLERANCE + 1e-12


def fault(cells: Sequence[Expression], params: Mapping[str, float]) -> str | None:
    """Why the cells are no distribution, in words; None if they are one within TOLERANCE."""
    values: list[float] = []
    for cell in cells:
        try:
            value = evaluate(cell, params)
        except EvaluationError as error:
            return f"has `{expression_text(cell)}`, which has no value: {error}"
        if value < 0:
            return f"has `{expression_text(cell)}`, which is negative ({value:g})"
        values.append(value)
    total = math.fsum(values)
    if not is_one(total):
        return f"sums to {number_text(round(total, 9))}, not 1"
    return None


@dataclass(frozen=True, slots=True)
class ColumnFault:
    """A column that is no distribution with the params as they are."""

    action: Action
    rule: Rule
    column: Column
    reason: str

    @property
    def span(self) -> Span | None:
        """Where the rule or block stands, if the domain was read from a text."""
        return self.column.block.span if self.column.block else self.rule.span

    def __str__(self) -> str:
        where = f" for {', '.join(self.column.values)}" if self.column.values else ""
        name = f"column {self.column.environment}" if self.column.environment else "the column"
        return f"{name}{where} of rule {self.action.name}.{self.rule.name} {self.reason}"


def column_faults(domain: Domain, params: Mapping[str, float]) -> Iterator[ColumnFault]:
    """Every column that is no distribution; to be asked again whenever a param is set."""
    for action in domain.actions:
        for rule in action.rules:
            for column in columns(rule):
                reason = fault(column.cells, params)
                if reason is not None:
                    yield ColumnFault(action, rule, column, reason)
