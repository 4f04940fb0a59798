"""A problem made flat without grounding it: each rule an action with parameters.

Deictic references become parameters of which the condition says that nothing else fits; a rule covers
only where no other rule of its action does; derived predicates are put in where they are used; what a
count asks for is said with as many variables.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
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
from menid_plan.grounding.semantics import Noise
from menid_plan.model.domain import (
    Domain,
    Object,
    Predicate,
    Problem,
    StateReward,
    objects_by_type,
    param_values,
)
from menid_plan.model.expressions import EvaluationError, Number
from menid_plan.model.formulas import (
    TRUE,
    And,
    Atom,
    Constant,
    Count,
    Equality,
    Exists,
    ForAll,
    Formula,
    Implies,
    Not,
    Or,
    Term,
    Truth,
    TypedVariable,
    Variable,
    conjunction,
    disjunction,
    negation,
)
from menid_plan.model.rules import (
    NOISE,
    Action,
    Block,
    ConditionalEffect,
    Effect,
    Literal,
    Outcome,
    Reference,
    Rule,
    UniversalEffect,
)
from menid_plan.model.strata import is_recursive, strata
from menid_plan.model.variables import free_variables, put_in, renamed, replaced, told_apart
from menid_plan.source import Span

# Variables that stand for what a count asks for, in one formula.
MAX_COUNTED = 12
# Parts of a formula, once all derived predicates are put in.
MAX_SIZE = 20_000


def lifted(
    domain: Domain,
    problem: Problem,
    environment: str | None = None,
    params: Mapping[str, float] | None = None,
    noise: Noise = "stay",
    *,
    split: bool = True,
) -> Flat:
    """A flat problem with the probabilities of one environment (None: the target).

    Where a rule has distributions of its own for some objects, these get actions of their own with
    ``split``; else the flat rule has `probabilities` for them. Raises NotExpressibleError, with the
    place, for what can't be made flat this way: recursive derived predicates, large counts, formulas
    that grow too large.
    """
    return _Lifting(
        domain, problem, environment or domain.target, params or {}, noise, split
    ).flat()


class _Lifting:
    def __init__(
        self, domain: Domain, problem: Problem, environment: str,
        params: Mapping[str, float], noise: Noise, split: bool,
    ) -> None:  # fmt: skip
        known = [each.name for each in domain.all_environments]
        if environment not in known:
            raise MeaningError(
                f"there is no environment `{environment}`; the domain has: {', '.join(known)}"
            )
        self.domain, self.problem = domain, problem
        self.environment, self.noise, self.split = environment, noise, split
        try:
            self.params = param_values(domain, problem, params)
        except EvaluationError as error:
            raise MeaningError(str(error)) from error
        self.members = objects_by_type(domain, (*domain.constants, *problem.objects))
        self._derived = {predicate.name: predicate for predicate in domain.derived}
        self._definitions: dict[str, Formula] = {}
        self._recursive = {p.name for s in strata(domain) if is_recursive(s) for p in s}
        self._names: set[str] = set()
        self._calls: dict[str, Call] = {}
        predicates = {p.name for p in domain.predicates} | {p.name for p in domain.derived}
        self._sunk = unused("sunk", predicates)
        self._sinks = False

    def flat(self) -> Flat:
        """The flat problem."""
        d, p = self.domain, self.problem
        rewards = tuple(
            StateReward(
                number(each.reward, self.params, "a reward of states"),
                told_apart(self.formula(each.condition, each.span), _names(each.variables)),
                each.variables,
            )
            for each in d.rewards
        )
        self._names.update(action.name for action in d.actions if len(action.rules) > 1)
        actions = tuple(made for action in d.actions for made in self._actions(action))
        goal = None if p.goal is None else told_apart(self.formula(p.goal, p.span), ())
        predicates = d.predicates
        if self._sinks:
            predicates = (*predicates, Predicate(self._sunk))
            going_on = Not(Atom(self._sunk))
            actions = tuple(only_where(action, going_on) for action in actions)
            goal = None if goal is None else conjunction([goal, going_on])
        objects = (*d.constants, *(Object(o.name, o.type) for o in p.objects))
        flat = Domain(
            d.name, d.types, objects, (), (), predicates, (), rewards, actions, d.doc, d.span
        )
        return Flat(
            flat,
            Problem(
                p.name, d.name, (), (), p.init, goal,
                number(p.goal_reward, self.params, "the goal's reward") if p.goal_reward else None,
                p.horizon, p.discount,
                number(p.dead_end_reward, self.params, "the dead end's reward")
                if p.dead_end_reward
                else None,
                p.doc, p.span,
            ),
            self._calls, self._sunk if self._sinks else "",
        )  # fmt: skip

    # ------------------------------------------------------------------------------------ formulas

    def formula(self, formula: Formula, span: Span | None) -> Formula:
        """A formula without derived predicates and counts; ``span`` is where it stands."""
        found = self._plain(formula, span)
        if size_of(found) > MAX_SIZE:
            raise NotExpressibleError(
                "the formula grows too large once its derived predicates are put in", span
            )
        return found

    def _plain(self, formula: Formula, span: Span | None) -> Formula:
        match formula:
            case Truth() | Equality():
                return formula
            case Atom(predicate, arguments):
                if predicate not in self._derived:
                    return formula
                names = (variable.name for variable in self._derived[predicate].parameters)
                terms = dict(zip(names, arguments, strict=True))
                return replaced(self._definition(predicate), terms)
            case Not(operand):
                return negation(self._plain(operand, span))
            case And(formulas):
                return conjunction(self._plain(f, span) for f in formulas)
            case Or(formulas):
                return disjunction(self._plain(f, span) for f in formulas)
            case Implies(premise, conclusion):
                return Implies(self._plain(premise, span), self._plain(conclusion, span))
            case Exists(variables, body):
                return Exists(variables, self._plain(body, span))
            case ForAll(variables, body):
                return ForAll(variables, self._plain(body, span))
            case Count(variables, body, comparison, wanted):
                plain = self._plain(body, span)
                most = {"<": wanted - 1, ">=": wanted - 1}.get(comparison, wanted)
                more = self._more_than(most, variables, plain, span)
                if comparison in (">", ">="):
                    return more
                if comparison in ("<", "<="):
                    return negation(more)
                less = negation(self._more_than(wanted - 1, variables, plain, span))
                different = disjunction([more, less])
                return different if comparison == "!=" else negation(different)

    def _definition(self, predicate: str) -> Formula:
        """What a derived predicate stands for, in terms of basic ones."""
        found = self._definitions.get(predicate)
        if found is None:
            derived = self._derived[predicate]
            if predicate in self._recursive:
                raise NotExpressibleError(
                    f"the derived predicate `{predicate}` is recursive", derived.span
                )
            found = self._definitions[predicate] = self.formula(derived.formula, derived.span)
        return found

    def _more_than(
        self, most: int, variables: tuple[TypedVariable, ...], body: Formula, span: Span | None
    ) -> Formula:
        """Whether more tuples than so many satisfy a formula."""
        if most < 0:
            return TRUE
        if (most + 1) * len(variables) > MAX_COUNTED:
            raise NotExpressibleError(f"a count of more than {most} takes too many variables", span)
        taken = free_variables(body) | set(_names(variables))
        tuples = [variables]
        parts = [body]
        for _ in range(most):
            others, terms = renamed(variables, taken)
            taken |= set(_names(others))
            tuples.append(others)
            parts.append(replaced(body, terms))
        different = (negation(_same(a, b)) for a, b in combinations(tuples, 2))
        every = tuple(variable for group in tuples for variable in group)
        return Exists(every, conjunction([*parts, *different]))

    # --------------------------------------------------------------------------------------- rules

    def _actions(self, action: Action) -> Iterator[Action]:
        for rule in action.rules:
            references = [
                replace(each, formula=self.formula(each.formula, each.span or rule.span))
                for each in rule.references
            ]
            variables = [variable for each in references for variable in each.variables]
            condition = conjunction(
                [
                    *(part for each in references for part in _names_one(each)),
                    self.formula(rule.condition, rule.span),
                    *(
                        negation(self._covering(other))
                        for other in action.rules
                        if other is not rule
                        and not other.otherwise
                        and (rule.otherwise or not exclude(rule, other))
                    ),
                ]
            )
            name = action.name if len(action.rules) == 1 else f"{action.name}-{rule.name}"
            parameters = (*action.parameters, *variables)
            made = replace(action, name=name, parameters=parameters, doc=rule.doc, span=rule.span)
            if self.split:
                yield from self._split(action, rule, made, condition)
            else:
                yield self._whole(action, rule, made, condition)

    def _covering(self, rule: Rule) -> Formula:
        """Where a rule covers, as a formula of the action's parameters."""
        found = self.formula(rule.condition, rule.span)
        for reference in reversed(rule.references):
            named = replace(
                reference, formula=self.formula(reference.formula, reference.span or rule.span)
            )
            found = Exists(named.variables, conjunction([*_names_one(named), found]))
        return found

    def _split(
        self, action: Action, rule: Rule, made: Action, condition: Formula
    ) -> Iterator[Action]:
        """An action for each value of `per` with numbers of its own, and one for all others."""
        types = {parameter.name: parameter.types for parameter in action.parameters}
        there = [
            {name for type_ in types[parameter] for name in self.members[type_]}
            for parameter in rule.per
        ]
        own = list(
            dict.fromkeys(
                block.values
                for block in rule.probabilities
                if block.values and self.environment in block.environments
                and all(value in known for value, known in zip(block.values, there, strict=True))
            )
        )  # fmt: skip
        others: list[Formula] = []
        for values in own:
            terms: dict[str, Term] = {
                parameter: Constant(value)
                for parameter, value in zip(rule.per, values, strict=True)
            }
            others.append(
                Not(conjunction(Equality(Variable(v), term) for v, term in terms.items()))
            )
            yield self._named(
                action,
                replace(
                    made,
                    name="-".join((made.name, *values)),
                    parameters=tuple(v for v in made.parameters if v.name not in terms),
                ),
                rule, self._chances(action, rule, values), replaced(condition, terms), terms,
            )  # fmt: skip
        instances = 1
        for known in there:
            instances *= len(known)
        if len(own) < instances:
            yield self._named(
                action, made, rule, self._chances(action, rule, ()),
                conjunction([condition, *others]), {},
            )  # fmt: skip

    def _whole(self, action: Action, rule: Rule, made: Action, condition: Formula) -> Action:
        """One action for a rule, which keeps its `per` parameters and the numbers of each."""
        own = dict.fromkeys(
            b.values for b in rule.probabilities if b.values and self.environment in b.environments
        )
        general = rule.probability_cells(self.environment)
        chances = None if general is None and own else self._chances(action, rule, ())
        rows = [self._chances(action, rule, values) for values in own]
        noisy = any(row[-1] > 0 for row in (*rows, chances or (0.0,)))
        flat = self._named(action, made, rule, chances, condition, {}, noisy=noisy)
        names = [outcome.name for outcome in flat.rules[0].outcomes]
        blocks = []
        for values, row in zip(own, rows, strict=True):
            cells = [(Number(p),) for p in row]
            if len(cells) < len(names):
                cells.append((Number(0.0),))
            blocks.append(Block(("target",), values, tuple(zip(names, cells, strict=True))))
        new = replace(flat.rules[0], per=rule.per, probabilities=tuple(blocks))
        return replace(flat, rules=(new,))

    def _chances(self, action: Action, rule: Rule, values: tuple[str, ...]) -> list[float]:
        return distribution(action.name, rule, self.environment, values, self.params)

    def _named(
        self, action: Action, made: Action, rule: Rule, chances: Sequence[float] | None,
        condition: Formula, terms: Mapping[str, Term], *, noisy: bool | None = None,
    ) -> Action:  # fmt: skip
        """A flat action under a name that no other has, and what it stands for.

        ``noisy``: whether noise can occur, if the chances do not tell.
        """
        if noisy is None:
            noisy = chances is not None and chances[-1] > 0
        name = unused(made.name, self._names)
        self._names.add(name)
        arguments = tuple(put_in(Variable(v.name), terms) for v in action.parameters)
        there = {v.name for v in made.parameters}
        named = (
            (v.name, put_in(Variable(v.name), terms)) for r in rule.references for v in r.variables
        )
        references = tuple(
            (v, term) for v, term in named if isinstance(term, Constant) or term.name in there
        )
        self._calls[name] = Call(action.name, arguments, rule.name, references)
        own = _names(made.parameters)
        outcomes = tuple(self._outcomes(rule, chances, terms, own, noisy))
        condition = told_apart(condition, own)
        flat = Rule(rule.name, outcomes, condition=condition, doc=rule.doc, span=rule.span)
        cost = number(action.cost, self.params, f"the cost of action `{action.name}`")
        return replace(made, name=name, rules=(flat,), cost=cost if action.cost else None)

    def _outcomes(
        self, rule: Rule, chances: Sequence[float] | None, terms: Mapping[str, Term],
        taken: Sequence[str], noisy: bool,
    ) -> Iterator[Outcome]:  # fmt: skip
        """Outcomes whose cells are numbers, and whose effects are plain; noise comes last."""
        for index, outcome in enumerate(rule.outcomes):
            chance = None if chances is None else chances[index]
            cells = () if chance is None else (Number(chance),)
            reward = None
            if outcome.reward is not None:
                what = f"the reward of outcome `{outcome.name}`"
                reward = number(outcome.reward, self.params, what)
            name, effects = outcome.name, tuple(self._effects(outcome, terms, taken))
            if outcome.is_noise and self.noise == "sink" and noisy:
                self._sinks = True
                name = unused("sinks", {each.name for each in rule.outcomes})
                effects = (Literal(Atom(self._sunk)),)
            yield Outcome(name, cells, effects, reward, outcome.doc, outcome.span)
            if name != NOISE and outcome.is_noise:
                yield Outcome(NOISE, () if chance is None else (Number(0.0),))

    def _effects(
        self, outcome: Outcome, terms: Mapping[str, Term], taken: Sequence[str]
    ) -> Iterator[Effect]:
        for effect in outcome.effects:
            match effect:
                case Literal():
                    yield _literal(effect, terms)
                case ConditionalEffect(condition, literals):
                    where = replaced(self.formula(condition, outcome.span), terms)
                    yield ConditionalEffect(told_apart(where, taken), _literals(literals, terms))
                case UniversalEffect(variables, condition, literals):
                    where = replaced(self.formula(condition, outcome.span), terms)
                    names = (*taken, *_names(variables))
                    yield UniversalEffect(
                        variables, told_apart(where, names), _literals(literals, terms)
                    )


def _names(variables: Iterable[TypedVariable]) -> list[str]:
    return [variable.name for variable in variables]


def _literal(literal: Literal, terms: Mapping[str, Term]) -> Literal:
    arguments = tuple(put_in(term, terms) for term in literal.atom.arguments)
    return Literal(Atom(literal.atom.predicate, arguments), literal.positive)


def _literals(literals: Sequence[Literal], terms: Mapping[str, Term]) -> tuple[Literal, ...]:
    return tuple(_literal(literal, terms) for literal in literals)


def _names_one(reference: Reference) -> tuple[Formula, Formula]:
    """That the variables of a reference satisfy its formula, and that no others do."""
    own = _names(reference.variables)
    others, terms = renamed(reference.variables, {*free_variables(reference.formula), *own})
    alone = ForAll(
        others,
        Implies(replaced(reference.formula, terms), _same(others, reference.variables)),
    )
    return reference.formula, alone


def _same(left: Sequence[TypedVariable], right: Sequence[TypedVariable]) -> Formula:
    """That two tuples of variables name the same objects."""
    return conjunction(
        Equality(Variable(a.name), Variable(b.name)) for a, b in zip(left, right, strict=True)
    )


def exclude(rule: Rule, other: Rule) -> bool:
    """Whether it is plain to see that two rules of an action never cover the same state.

    It is where one demands what the other rules out, and both of the same objects: references that
    read alike name the same.
    """
    terms: dict[str, Term] = {}
    alike = True
    for ours, theirs in zip(rule.references, other.references, strict=False):
        same = dict(terms)
        same.update(
            (b.name, Variable(a.name))
            for a, b in zip(ours.variables, theirs.variables, strict=False)
        )
        alike = (
            alike
            and [v.types for v in ours.variables] == [v.types for v in theirs.variables]
            and ours.formula == replaced(theirs.formula, same)
        )
        if not alike:
            break
        terms = same
    # All other variables of the other rule are told apart from those of this one.
    rest = (v for reference in other.references for v in reference.variables)
    apart = {v.name: Variable(f"{v.name}'") for v in rest if v.name not in terms}
    demands = set(_demands(rule, {}))
    return any(negation(part) in demands for part in _demands(other, {**apart, **terms}))


def _demands(rule: Rule, terms: Mapping[str, Term]) -> Iterator[Formula]:
    for formula in (*(reference.formula for reference in rule.references), rule.condition):
        yield from _parts(replaced(formula, terms))


def _parts(formula: Formula) -> Iterable[Formula]:
    if isinstance(formula, And):
        return [part for operand in formula.formulas for part in _parts(operand)]
    return [formula]
