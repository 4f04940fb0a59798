"""A problem made flat by grounding it: each ground rule an action without parameters.

Only facts that change are left; recursive derived predicates are unfolded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

from menid_plan.errors import MeaningError
from menid_plan.exchange.flat import (
    Call,
    Flat,
    NotExpressibleError,
    distribution,
    number,
    only_where,
    size_of,
    unused,
)
from menid_plan.exchange.lifted import exclude
from menid_plan.grounding.circuit import FALSE, TRUE, Circuit, Signal
from menid_plan.grounding.instantiate import GroundEffect, GroundRule, Instantiation
from menid_plan.grounding.prune import prune
from menid_plan.grounding.semantics import Noise
from menid_plan.model.domain import (
    Domain,
    Object,
    Predicate,
    Problem,
    StateReward,
    param_values,
)
from menid_plan.model.expressions import EvaluationError, Number
from menid_plan.model.formulas import (
    Atom,
    Constant,
    Formula,
    GroundAtom,
    Not,
    Truth,
    conjunction,
    disjunction,
    negation,
)
from menid_plan.model.rules import Action, ConditionalEffect, Effect, Literal, Outcome, Rule

# Parts of all formulas together, written out.
MAX_SIZE = 2_000_000
# Parts of one formula, written out.
MAX_FORMULA = 100_000


def grounded(
    domain: Domain,
    problem: Problem,
    environment: str | None = None,
    params: Mapping[str, float] | None = None,
    noise: Noise = "stay",
) -> Flat:
    """A flat problem without parameters, with the probabilities of one environment (None: the target).

    Raises NotExpressibleError if formulas grow too large, as recursive derived predicates of many
    objects do; LimitError if there is too much to ground.
    """
    environment = environment or domain.target
    known = [each.name for each in domain.all_environments]
    if environment not in known:
        raise MeaningError(
            f"there is no environment `{environment}`; the domain has: {', '.join(known)}"
        )
    try:
        values = param_values(domain, problem, params)
    except EvaluationError as error:
        raise MeaningError(str(error)) from error
    work = Instantiation(domain, problem)
    rules = list(work.rules())
    rewards, signals = [], []
    for reward in domain.rewards:
        for signal in work.bound_signals(reward.variables, reward.condition):
            rewards.append(number(reward.reward, values, "a reward of states"))
            signals.append(signal)
    goal = TRUE if problem.goal is None else work.signal(problem.goal, {})
    pruned = prune(work.circuit, rules, [goal, *signals], work.init)
    formulas = _Formulas(pruned.circuit)
    actions = _Actions(domain, environment, values, noise, formulas)
    made = tuple(actions.of(pruned.rules))
    goals = formulas.formula(pruned.signals[0])
    predicates = domain.predicates
    if actions.sinks:
        sunk = Atom(actions.sunk)
        predicates = (*predicates, Predicate(actions.sunk))
        made = tuple(only_where(action, Not(sunk)) for action in made)
        goals = conjunction([goals, Not(sunk)])
    flat = Domain(
        domain.name, domain.types,
        (*domain.constants, *(Object(o.name, o.type) for o in problem.objects)),
        (), (), predicates, (),
        tuple(
            StateReward(reward, formulas.formula(signal))
            for reward, signal in zip(rewards, pruned.signals[1:], strict=True)
            if signal != FALSE
        ),
        made, domain.doc, domain.span,
    )  # fmt: skip
    flat_problem = replace(
        problem,
        params=(),
        objects=(),
        goal=None if problem.goal is None else goals,
        goal_reward=number(problem.goal_reward, values, "the goal's reward")
        if problem.goal_reward
        else None,
        dead_end_reward=number(problem.dead_end_reward, values, "the dead end's reward")
        if problem.dead_end_reward
        else None,
    )
    return Flat(flat, flat_problem, actions.calls, actions.sunk if actions.sinks else "")


class _Formulas:
    """Signals of a circuit as formulas."""

    def __init__(self, circuit: Circuit) -> None:
        self.circuit = circuit
        self._known: dict[Signal, Formula] = {}
        self._total = 0
        self._left = 0
        self._recursive = _above_derived(circuit)

    def formula(self, signal: Signal) -> Formula:
        """The formula of a signal; NotExpressibleError if it is too large."""
        self._left = MAX_FORMULA
        found = self._formula(signal, frozenset())
        size = size_of(found)
        self._total += size
        if size > MAX_FORMULA or self._total > MAX_SIZE:
            raise NotExpressibleError("the ground formulas are too large to be written out")
        return found

    def _formula(self, signal: Signal, path: frozenset[int]) -> Formula:
        """The formula of a signal; ``path`` are the derived atoms that are being unfolded.

        Whatever derives an atom can do so without the atom itself, so it is false below its own
        definition.
        """
        recursive = signal >> 1 in self._recursive
        if signal in self._known and not recursive:
            return self._known[signal]
        self._left -= 1
        if self._left < 0:
            raise NotExpressibleError(
                "the ground formulas are too large to be written out, once recursive derived"
                " predicates are unfolded"
            )
        node = self.circuit.nodes[signal >> 1]
        negated = bool(signal & 1)
        match node.kind:
            case "constant":
                found: Formula = Truth(negated)
            case "fact":
                assert node.atom is not None
                found = ground_formula(node.atom)
                found = negation(found) if negated else found
            case "all" if negated:
                found = disjunction(self._formula(each ^ 1, path) for each in node.operands)
            case "all":
                found = conjunction(self._formula(each, path) for each in node.operands)
            case "count":
                found = self._count(signal >> 1, path)
                found = negation(found) if negated else found
            case "derived":
                own = signal >> 1
                found = Truth(False)
                if own not in path:
                    found = self._formula(self.circuit.definitions[own], path | {own})
                found = negation(found) if negated else found
        if not recursive:
            self._known[signal] = found
        return found

    def _count(self, number: int, path: frozenset[int]) -> Formula:
        node = self.circuit.nodes[number]
        operands = [self._formula(each, path) for each in node.operands]

        def at_least(wanted: int) -> Formula:
            found = []
            for some in combinations(operands, wanted):
                self._left -= wanted
                if self._left < 0:
                    raise NotExpressibleError(
                        f"a count of {len(operands)} is too large to be written out"
                    )
                found.append(conjunction(some))
            return disjunction(found)

        enough = at_least(node.number)
        if node.comparison == ">=":
            return enough
        return conjunction([enough, negation(at_least(node.number + 1))])


def ground_formula(atom: GroundAtom) -> Atom:
    """A ground atom as a formula."""
    return Atom(atom.predicate, tuple(Constant(name) for name in atom.arguments))


def _above_derived(circuit: Circuit) -> set[int]:
    """The nodes that depend on recursive derived atoms."""
    users: dict[int, list[int]] = {}
    for node in range(len(circuit.nodes)):
        for operand in circuit.operands(node):
            users.setdefault(operand >> 1, []).append(node)
    found = {n for n, node in enumerate(circuit.nodes) if node.kind == "derived"}
    pending = list(found)
    while pending:
        for user in users.get(pending.pop(), ()):
            if user not in found:
                found.add(user)
                pending.append(user)
    return found


class _Actions:
    """Makes an action of each ground rule."""

    def __init__(
        self, domain: Domain, environment: str, params: Mapping[str, float], noise: Noise,
        formulas: _Formulas,
    ) -> None:  # fmt: skip
        self.domain, self.environment, self.noise = domain, environment, noise
        self.params, self.formulas = params, formulas
        self.calls: dict[str, Call] = {}
        self.sinks = False
        predicates = {p.name for p in domain.predicates} | {p.name for p in domain.derived}
        self.sunk = unused("sunk", predicates)
        self._chances: dict[tuple[str, str, tuple[str, ...]], list[float]] = {}

    def of(self, rules: Sequence[GroundRule]) -> Iterator[Action]:
        """The actions, in the order of the rules."""
        together: dict[object, list[GroundRule]] = {}
        for rule in rules:
            together.setdefault(rule.action, []).append(rule)
        for group in together.values():
            for rule in group:
                yield self._action(rule, [o for o in group if o.rule is not rule.rule])

    def _action(self, rule: GroundRule, others: Sequence[GroundRule]) -> Action:
        action = self.domain.action(rule.action.action)
        named = {v.name: rule.binding[v.name] for r in rule.rule.references for v in r.variables}
        parts = (action.name, *rule.action.arguments)
        if len(action.rules) > 1:
            parts = (*parts, rule.rule.name)
        name = unused("-".join((*parts, *named.values())), self.calls)
        self.calls[name] = Call(
            action.name, tuple(map(Constant, rule.action.arguments)), rule.rule.name,
            tuple((variable, Constant(thing)) for variable, thing in named.items()),
        )  # fmt: skip
        circuit = self.formulas.circuit
        rivals = [
            negation(self.formulas.formula(other.condition))
            for other in others
            if not (rule.rule.otherwise or other.rule.otherwise)
            and not exclude(rule.rule, other.rule)
            and circuit.conjunction((rule.condition, other.condition)) != FALSE
        ]
        condition = conjunction([self.formulas.formula(rule.condition), *rivals])
        cost = number(action.cost, self.params, f"the cost of action `{action.name}`")
        flat = Rule(rule.rule.name, tuple(self._outcomes(action, rule)), condition=condition)
        return Action(
            name, (flat,), (), cost if action.cost else None, rule.rule.doc, rule.rule.span
        )

    def _outcomes(self, action: Action, rule: GroundRule) -> Iterator[Outcome]:
        key = (action.name, rule.rule.name, rule.values)
        if key not in self._chances:
            self._chances[key] = distribution(
                action.name, rule.rule, self.environment, rule.values, self.params
            )
        names = {outcome.name for outcome in rule.rule.outcomes}
        for outcome, chance, effects in zip(
            rule.rule.outcomes, self._chances[key], rule.effects, strict=True
        ):
            reward = None
            if outcome.reward is not None:
                what = f"the reward of outcome `{outcome.name}`"
                reward = number(outcome.reward, self.params, what)
            cells = (Number(chance),)
            if outcome.is_noise and self.noise == "sink" and chance > 0:
                self.sinks = True
                sunk = (Literal(Atom(self.sunk)),)
                yield Outcome(unused("sinks", names), cells, sunk, reward)
                cells, reward = (Number(0.0),), None
            yield Outcome(outcome.name, cells, tuple(self._effects(effects)), reward)

    def _effects(self, effects: Sequence[GroundEffect]) -> Iterator[Effect]:
        for effect in effects:
            literals = (
                *(Literal(ground_formula(atom), positive=False) for atom in effect.delete),
                *(Literal(ground_formula(atom)) for atom in effect.add),
            )
            if effect.condition == TRUE:
                yield from literals
            else:
                yield ConditionalEffect(self.formulas.formula(effect.condition), literals)
