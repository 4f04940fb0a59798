"""Actions and their MENID rules, lifted: outcomes, noise, deictic references, evidence by environment.

A rule is the paper's a_r(chi): phi(chi) -> {jp_i : Omega_i}, eq. (1) of Suárez-Hernández et al.,
"Leveraging Multiple Environments for Learning and Decision Making", IROS 2020.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from menid_plan.model.expressions import ZERO, Expression
from menid_plan.model.formulas import TRUE, Atom, Formula, TypedVariable
from menid_plan.source import Span

NOISE = "noise"


@dataclass(frozen=True, slots=True)
class Literal:
    """An atom of a basic predicate that an effect adds or, if not ``positive``, deletes."""

    atom: Atom
    positive: bool = True


@dataclass(frozen=True, slots=True)
class ConditionalEffect:
    """``if condition { effects }``: happens where the condition held before the step."""

    condition: Formula
    effects: tuple[Literal, ...]


@dataclass(frozen=True, slots=True)
class UniversalEffect:
    """``forall variables where condition { effects }``: for every binding for which it held."""

    variables: tuple[TypedVariable, ...]
    condition: Formula
    effects: tuple[Literal, ...]


Effect: TypeAlias = Literal | ConditionalEffect | UniversalEffect


@dataclass(frozen=True, slots=True)
class Outcome:
    """One outcome of a rule: its name, a cell for each column of the rule, effects and reward."""

    name: str
    cells: tuple[Expression, ...] = ()
    effects: tuple[Effect, ...] = ()
    reward: Expression | None = None
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)

    @property
    def literals(self) -> Iterator[Literal]:
        """All that its effects may add or delete, wherever it stands in them."""
        for effect in self.effects:
            yield from (effect,) if isinstance(effect, Literal) else effect.effects

    @property
    def is_noise(self) -> bool:
        """Whether this is the outcome that stands for whatever no other describes."""
        return self.name == NOISE


@dataclass(frozen=True, slots=True)
class Reference:
    """A deictic reference: ``the variables where formula`` names the one tuple that satisfies it."""

    variables: tuple[TypedVariable, ...]
    formula: Formula
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Block:
    """A ``probabilities`` or ``observed`` block: rows of cells, for one value of the rule's `per`.

    ``rows`` maps an outcome's name to one cell for each of ``environments``; rows left out are 0.
    ``values`` is empty for a block without ``for``.
    """

    environments: tuple[str, ...]
    values: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Expression, ...]], ...]
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)

    def column(self, environment: str, outcomes: Sequence[Outcome]) -> tuple[Expression, ...]:
        """The cells of one environment, one for each outcome in order."""
        index = self.environments.index(environment)
        cells = {name: row[index] for name, row in self.rows}
        return tuple(cells.get(outcome.name, ZERO) for outcome in outcomes)


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule of an action.

    ``outcomes`` always ends with the noise outcome, whether the text has a row for it or not.
    ``environments`` is the head of the outcome table; empty, its one column (if there is one) serves
    every environment. An ``otherwise`` rule has no references and the condition TRUE.
    """

    name: str
    outcomes: tuple[Outcome, ...]
    per: tuple[str, ...] = ()
    references: tuple[Reference, ...] = ()
    condition: Formula = TRUE
    otherwise: bool = False
    environments: tuple[str, ...] = ()
    probabilities: tuple[Block, ...] = ()
    observed: tuple[Block, ...] = ()
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)

    @property
    def has_column(self) -> bool:
        """Whether the outcome table itself has probabilities."""
        return any(outcome.cells for outcome in self.outcomes)

    def probability_cells(
        self, environment: str, values: tuple[str, ...] = ()
    ) -> tuple[Expression, ...] | None:
        """The probabilities that count in an environment, one for each outcome, noise last.

        The first that is written of: ``probabilities`` for these values of ``per``, ``probabilities``
        for the rule, the environment's column of the outcomes, the single column. None: unknown.
        """
        for wanted in (values, ()):
            for block in self.probabilities:
                if block.values == wanted and environment in block.environments:
                    return block.column(environment, self.outcomes)
        if not self.has_column:
            return None
        if not self.environments:
            index = 0
        elif environment in self.environments:
            index = self.environments.index(environment)
        else:
            return None
        return tuple(o.cells[index] if o.cells else ZERO for o in self.outcomes)

    def observed_cells(
        self, environment: str, values: tuple[str, ...] = ()
    ) -> tuple[Expression, ...] | None:
        """The counts written for an environment and value, one for each outcome; None: no block."""
        for block in self.observed:
            if block.values == values and environment in block.environments:
                return block.column(environment, self.outcomes)
        return None


@dataclass(frozen=True, slots=True)
class Action:
    """What can be executed: parameters, a cost paid at each execution, and one rule or more."""

    name: str
    rules: tuple[Rule, ...]
    parameters: tuple[TypedVariable, ...] = ()
    cost: Expression | None = None
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)
