"""What was seen of every distribution, by environment, and what is believed after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from menid_plan.environments.settings import SettingError
from menid_plan.errors import MeaningError
from menid_plan.experience.record import DistributionKey
from menid_plan.grounding.ground import GroundProblem
from menid_plan.learning.estimators import Estimator
from menid_plan.learning.mixtures import MOST, DirichletMixture
from menid_plan.mdp.model import Floats
from menid_plan.model.domain import Domain, Problem, param_values
from menid_plan.model.expressions import ZERO, EvaluationError, Expression, Number, evaluate
from menid_plan.model.probabilities import fault
from menid_plan.model.rules import Block, Rule


class Evidence:
    """Counts of the outcomes of every distribution in some environments, the target first.

    It starts from the domain's `observed` blocks. Beliefs are kept until the counts behind them
    change, so that learning from an experience costs the same however much is known already.
    ``prior_weight`` is how many executions the probabilities that the domain gives for the target are
    worth; 0 leaves them out. Raises SettingError for a weight, MeaningError for `observed` counts,
    with which nothing can be computed.
    """

    def __init__(
        self,
        domain: Domain,
        problem: Problem,
        environments: Sequence[str],
        estimator: Estimator,
        prior_weight: float = 0.0,
        params: Mapping[str, float] | None = None,
    ) -> None:
        if not 0.0 <= prior_weight <= MOST:
            raise SettingError("prior_weight", f"it must lie between 0 and {MOST:g}")
        self.domain = domain
        self.environments = tuple(environments)
        self.estimator = estimator
        self.prior_weight = prior_weight
        self._params = param_values(domain, problem, params)
        self._rules = {(a.name, r.name): r for a in domain.actions for r in a.rules}
        self._counts: dict[DistributionKey, Floats] = {}
        self._beliefs: dict[DistributionKey, DirichletMixture] = {}
        for (action, name), rule in self._rules.items():
            for values in dict.fromkeys(block.values for block in rule.observed):
                self.counts(DistributionKey(action, name, values))

    def rule(self, key: DistributionKey) -> Rule:
        """The rule of a distribution; KeyError if the domain has none of that name."""
        return self._rules[key.action, key.rule]

    @property
    def keys(self) -> list[DistributionKey]:
        """The distributions of which something was asked or seen, in order of the domain."""
        order = {name: number for number, name in enumerate(self._rules)}
        return sorted(self._counts, key=lambda key: (order[key.action, key.rule], key.values))

    def counts(self, key: DistributionKey) -> Floats:
        """How often each outcome was seen: float64[environments, outcomes], noise last."""
        found = self._counts.get(key)
        if found is None:
            rule = self.rule(key)
            found = np.zeros((len(self.environments), len(rule.outcomes)))
            for row, environment in enumerate(self.environments):
                cells = rule.observed_cells(environment, key.values)
                if cells is not None:
                    found[row] = [evaluate(cell, self._params) for cell in cells]
                    if not sum(found[row].tolist()) <= MOST:
                        raise MeaningError(
                            f"`{key}`: the counts observed in `{environment}` sum to more than "
                            f"{MOST:g}, beyond which nothing can be computed from them"
                        )
            self._counts[key] = found
        return found

    def add(self, environment: str, key: DistributionKey, weights: Sequence[float]) -> None:
        """Learn from an experience whose outcome has these weights (they sum to 1)."""
        self.counts(key)[self.environments.index(environment)] += weights
        self._beliefs.pop(key, None)

    def belief(self, key: DistributionKey) -> DirichletMixture:
        """What is believed of a distribution in the target."""
        found = self._beliefs.get(key)
        if found is None:
            found = self.estimator.posterior(self.counts(key), self._prior(key))
            self._beliefs[key] = found
        return found

    def knows(self, key: DistributionKey) -> bool:
        """Whether anything that was seen bears on the target, as the estimator has it."""
        counts = self.counts(key)
        if not counts.any():
            return False
        prior = self._prior(key)
        before = self.estimator.posterior(np.zeros_like(counts), prior)
        after = self.belief(key)
        return not (
            np.array_equal(before.parameters, after.parameters)
            and np.array_equal(before.weights, after.weights)
        )

    def answer(self, key: DistributionKey) -> Floats:
        """The estimate for the target; where nothing is known, what the domain gives, if it does."""
        if not self.knows(key):
            given = self.given(key, self.environments[0])
            if given is not None:
                return given
        return self.belief(key).estimate()

    def _prior(self, key: DistributionKey) -> Floats | None:
        if self.prior_weight <= 0.0:
            return None
        given = self.given(key, self.environments[0])
        return None if given is None else given * self.prior_weight

    def given(self, key: DistributionKey, environment: str) -> Floats | None:
        """The probabilities that the domain itself gives, float64[outcomes]; None if it gives none."""
        cells = self.rule(key).probability_cells(environment, key.values)
        if cells is None or fault(cells, self._params) is not None:
            return None
        try:
            column = np.array([evaluate(cell, self._params) for cell in cells])
        except EvaluationError:
            return None
        return np.asarray(column / column.sum())


class SlotBelief:
    """The beliefs of a ground problem's distributions, slot by slot; a `solving.Posterior`."""

    def __init__(self, evidence: Evidence, ground: GroundProblem) -> None:
        self.evidence = evidence
        self.keys = [DistributionKey(d.action, d.rule.name, d.values) for d in ground.distributions]

    def mean(self) -> Floats:
        """The estimator's answer for every slot."""
        return self._joined([self.evidence.belief(key).estimate() for key in self.keys])

    def learned(self) -> Floats:
        """What is to be planned with in the end; see `Evidence.answer`."""
        return self._joined([self.evidence.answer(key) for key in self.keys])

    def sample(self, rng: np.random.Generator) -> Floats:
        """Probabilities of every slot, drawn from what is believed."""
        return self._joined([self.evidence.belief(key).sample(rng) for key in self.keys])

    def domain(self, rng: np.random.Generator | None) -> Domain:
        """The domain with probabilities drawn from what is believed; without ``rng``, the expected."""
        beliefs = [self.evidence.belief(key) for key in self.keys]
        chances = [b.estimate() if rng is None else b.sample(rng) for b in beliefs]
        evidence = self.evidence
        return domain_with(evidence.domain, evidence.environments[0], self.keys, chances)

    @staticmethod
    def _joined(parts: list[Floats]) -> Floats:
        return np.concatenate(parts) if parts else np.zeros(0)


def agreement(target: Floats, test: Floats) -> float:
    """How probable it is that two environments share one distribution, if half of all do.

    Against two distributions of their own, all uniform over the simplex beforehand; ``target`` and
    ``test`` are counts (float64[k]). .5 says that nothing is known. (Jeffreys 1961.)
    """
    from menid_plan.learning.mixtures import log_beta

    one = np.ones(len(target))
    together = log_beta((one + target + test)[None])[0] + log_beta(one[None])[0]
    apart = log_beta((one + target)[None])[0] + log_beta((one + test)[None])[0]
    return float(1.0 / (1.0 + np.exp(min(700.0, apart - together))))


def learned_domain(evidence: Evidence, roles: Mapping[str, str] | None = None) -> Domain:
    """The domain with what was learned written into it, so that any problem can be solved by it.

    Each distribution that was seen gets an `observed` block with the counts, and the estimate for the
    target, in the table of outcomes or a `probabilities` block. Where nothing was seen what the
    domain gives stays; a rule for whose target it gives nothing gets the estimate without data.
    ``roles`` are the roles that its environments get.
    """
    domain = evidence.domain
    actions = []
    for action in domain.actions:
        keys = [k for k in evidence.keys if k.action == action.name and evidence.counts(k).any()]
        rules = (
            _learned_rule(evidence, action.name, rule, [k for k in keys if k.rule == rule.name])
            for rule in action.rules
        )
        actions.append(replace(action, rules=tuple(rules)))
    environments = tuple(
        replace(e, role="target" if (roles or {}).get(e.name, e.role) == "target" else "test")
        for e in domain.environments
    )
    return replace(domain, actions=tuple(actions), environments=environments)


def _learned_rule(
    evidence: Evidence, action: str, rule: Rule, keys: Sequence[DistributionKey]
) -> Rule:
    """A rule with what was learned of its distributions, ``keys`` being those that were seen."""
    estimated = [key for key in keys if evidence.knows(key)]
    if rule.probability_cells(evidence.environments[0]) is None and not any(
        not k.values for k in estimated
    ):
        estimated.insert(0, DistributionKey(action, rule.name))
    chances = {key.values: evidence.belief(key).estimate() for key in estimated}
    rule = _with_chances(rule, evidence.environments[0], chances, evidence.domain)
    observed = _without(rule.observed, evidence.environments, {key.values for key in keys})
    names = [outcome.name for outcome in rule.outcomes]
    for key in keys:
        counts = evidence.counts(key)
        seen = tuple(
            (name, tuple(Number(float(c)) for c in counts[:, i])) for i, name in enumerate(names)
        )
        observed.append(Block(evidence.environments, key.values, seen))
    return replace(rule, observed=tuple(observed))


def domain_with(
    domain: Domain, target: str, keys: Sequence[DistributionKey], chances: Sequence[Floats]
) -> Domain:
    """The domain with these probabilities (float64[outcomes] each) for some of its target's."""
    of_rule: dict[tuple[str, str], dict[tuple[str, ...], Floats]] = {}
    for key, column in zip(keys, chances, strict=True):
        of_rule.setdefault((key.action, key.rule), {})[key.values] = column
    actions = (
        replace(
            action,
            rules=tuple(
                _with_chances(r, target, of_rule.get((action.name, r.name), {}), domain)
                for r in action.rules
            ),
        )
        for action in domain.actions
    )
    return replace(domain, actions=tuple(actions))


def _with_chances(
    rule: Rule, target: str, chances: Mapping[tuple[str, ...], Floats], domain: Domain
) -> Rule:
    """A rule with probabilities for the target, by the values of its distributions."""
    probabilities = _without(rule.probabilities, (target,), set(chances))
    names = [outcome.name for outcome in rule.outcomes]
    for values, column in chances.items():
        cells = [Number(float(p)) for p in column]
        if not values and rule.has_column:
            rule = _with_column(rule, target, cells, domain)
        else:
            rows = tuple((name, (cell,)) for name, cell in zip(names, cells, strict=True))
            probabilities.append(Block((target,), values, rows))
    return replace(rule, probabilities=tuple(probabilities))


def _with_column(
    rule: Rule, environment: str, estimate: Sequence[Expression], domain: Domain
) -> Rule:
    """A rule whose outcome table has these cells in an environment's column."""
    heads = rule.environments or tuple(e.name for e in domain.all_environments)
    outcomes = []
    for outcome, cell in zip(rule.outcomes, estimate, strict=True):
        cells = list(outcome.cells) if rule.environments else list(outcome.cells) * len(heads)
        cells = cells or [ZERO] * len(heads)  # a row without cells is one of zeros
        if environment in heads:
            cells[heads.index(environment)] = cell
        else:
            cells.append(cell)
        outcomes.append(replace(outcome, cells=tuple(cells)))
    if environment not in heads:
        heads = (*heads, environment)
    return replace(rule, environments=heads, outcomes=tuple(outcomes))


def _without(
    blocks: Sequence[Block], environments: Sequence[str], values: set[tuple[str, ...]]
) -> list[Block]:
    """The blocks, less the columns of some environments for some values."""
    kept = []
    for block in blocks:
        columns = [i for i, e in enumerate(block.environments) if e not in environments]
        if block.values not in values or len(columns) == len(block.environments):
            kept.append(block)
        elif columns:
            rows = tuple((n, tuple(cells[i] for i in columns)) for n, cells in block.rows)
            names = tuple(block.environments[i] for i in columns)
            kept.append(replace(block, environments=names, rows=rows))
    return kept
