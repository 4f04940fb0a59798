"""What a domain writes of one environment: a number for each slot of a ground problem."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from menid_plan.errors import MeaningError
from menid_plan.grounding.ground import GroundProblem
from menid_plan.mdp.kernel import HAPPENS, MISSING, NEVER
from menid_plan.mdp.model import Floats
from menid_plan.model.expressions import EvaluationError, evaluate
from menid_plan.model.probabilities import fault


def written(problem: GroundProblem, environment: str) -> tuple[Floats, NDArray[np.uint8]]:
    """The probability of each slot in an environment, and whether its outcome happens.

    Columns are divided by their sums. Where nothing is written the probabilities are 0 and the second
    array has MISSING. Raises MeaningError for an unknown environment, or a column that the params
    make no distribution.
    """
    known = [e.name for e in problem.domain.all_environments]
    if environment not in known:
        raise MeaningError(
            f"there is no environment `{environment}`; the domain has: {', '.join(known)}"
        )
    chances = np.zeros(problem.slots)
    happens = np.full(problem.slots, MISSING, np.uint8)
    for distribution in problem.distributions:
        cells = distribution.rule.probability_cells(environment, distribution.values)
        if cells is None:
            continue
        reason = fault(cells, problem.params)
        if reason is not None:
            raise MeaningError(f"rule {distribution}, environment `{environment}`: {reason}")
        try:
            column = np.array([evaluate(cell, problem.params) for cell in cells])
        except EvaluationError as error:  # pragma: no cover - `fault` has looked already
            raise MeaningError(f"rule {distribution}: {error}") from error
        span = slice(distribution.start, distribution.start + len(cells))
        chances[span] = column / column.sum()
        happens[span] = np.where(column > 0, HAPPENS, NEVER)
    return chances, happens


def observed(problem: GroundProblem, environment: str) -> Floats:
    """How often each slot's outcome was seen in an environment, by the `observed` blocks; else 0."""
    counts = np.zeros(problem.slots)
    for distribution in problem.distributions:
        cells = distribution.rule.observed_cells(environment, distribution.values)
        if cells is not None:
            span = slice(distribution.slots.start, distribution.slots.stop)
            counts[span] = [evaluate(cell, problem.params) for cell in cells]
    return counts
