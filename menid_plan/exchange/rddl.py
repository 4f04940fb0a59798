"""RDDL in the subset that PROST, rddlsim and pyRDDLGym agree on (Sanner 2010 for the language).

RDDL draws every fluent on its own, so that what an outcome does together needs something drawn once
on which all of it depends. Two dialects differ in that. For ``pyrddlgym`` it is an interm-fluent, and
a step is a step. PROST has none: for ``prost`` a step is two, in the first of which an action is chosen
and its outcome drawn; in the second, nothing may be done, and the outcome takes effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from textwrap import indent

from menid_plan.exchange.classes import inhabited
from menid_plan.exchange.flat import Call, Flat
from menid_plan.exchange.names import changed
from menid_plan.exchange.rddl_model import (
    APPLIED,
    APPLYING,
    PLAYED,
    STOPPED,
    Dialect,
    Model,
    drawn,
)
from menid_plan.exchange.rddl_words import Words, infix, number, plain, total, when
from menid_plan.model.domain import StateReward
from menid_plan.model.formulas import (
    FALSE,
    TRUE,
    Atom,
    ForAll,
    GroundAtom,
    Implies,
    Variable,
    conjunction,
    disjunction,
    negation,
)
from menid_plan.model.rules import Action, Outcome

__all__ = ["Dialect", "Written", "rddl"]


@dataclass(frozen=True, slots=True)
class Written:
    """The texts of a domain and an instance, and what the names in them stand for.

    ``facts`` has for each predicate, or ground fact, that changes the fluent that stands for it;
    ``objects`` the names of objects; ``actions``, by the name of an action fluent, the names of its
    parameters and what it stands for, and ``doing`` the fluent that holds in its second phase.
    ``spaces`` has for each state and action fluent the names of the objects that each argument may be,
    and ``values`` the values of those that are no propositions, the usual one last. ``renamed`` has, by
    the new ones, names that were changed since RDDL has other uses for them. ``names`` has all else;
    see `rddl_words`.
    """

    domain: str
    instance: str
    horizon: int
    facts: Mapping[str | GroundAtom, str]
    objects: Mapping[str, str]
    actions: Mapping[str, tuple[tuple[str, ...], Call]]
    doing: Mapping[str, str]
    spaces: Mapping[str, tuple[tuple[str, ...], ...]]
    values: Mapping[str, tuple[str, ...]]
    renamed: Mapping[str, str]
    names: Mapping[str, str]
    sunk: str = ""


def rddl(flat: Flat, dialect: Dialect, horizon: int, *, stopping: bool = False) -> Written:
    """The texts of a flat problem that is played for so many steps.

    With ``stopping``, a step ends it all with a probability of 1 - discount, and nothing is
    discounted. If nothing at all is paid, reaching the goal pays 1. Raises NotExpressibleError for a
    problem without actions.
    """
    return _Writer(Model(inhabited(flat), dialect, horizon, stopping=stopping)).written()


class _Writer:
    def __init__(self, model: Model) -> None:
        self.model = model
        self.words = Words(model)
        self.names = self.words.names
        self._domain_name = plain(model.domain.name)
        self._name = plain(model.problem.name, [self._domain_name])

    def written(self) -> Written:
        model, names = self.model, self.names
        facts = model.flat.facts
        domain = "\n".join(self._domain()) + "\n"
        return Written(
            domain,
            "\n".join(self._instance()) + "\n",
            model.horizon,
            {facts.get(p.name, p.name): names[p.name] for p in model.dynamic},
            {each.name: names[f"object {each.name}"] for each in model.objects},
            {
                names[f"act {a.name}"]: (
                    tuple(v.name for v in a.parameters), model.flat.calls[a.name]
                )
                for a in model.actions
            },
            {names[f"act {a.name}"]: names[f"doing {a.name}"] for a in model.actions},
            dict(self._spaces()),
            {
                names[f"outcome {a.name}"]: tuple(self._value(a, o) for _, o in outcomes)
                for a, outcomes in self._drawing()
            },
            changed(self.words.given),
            names,
            model.flat.sunk,
        )  # fmt: skip

    def _spaces(self) -> Iterator[tuple[str, tuple[tuple[str, ...], ...]]]:
        model = self.model
        ranges = {p.name: p.arguments for p in model.dynamic}
        ranges |= dict.fromkeys(model.flags, ())
        ranges |= {f"act {a.name}": tuple(_ranges(a)) for a in model.actions}
        if model.two_phases:
            ranges |= {f"doing {a.name}": tuple(_ranges(a)) for a in model.actions}
            ranges |= {f"outcome {a.name}": () for a, _ in self._drawing()}
        for key, types in ranges.items():
            of = (model.classes.of[each[0]] for each in types)
            yield self.names[key], tuple(tuple(self._members(each)) for each in of)

    def _members(self, name: str) -> list[str]:
        """The names of the objects of a class."""
        model = self.model
        found = (o.name for o in model.objects if model.classes.of[o.type] == name)
        return [self.names[f"object {each}"] for each in found]

    # -------------------------------------------------------------------------------------- domain

    def _domain(self) -> Iterator[str]:
        # The declarations come last: only then is it known what the formulas speak of.
        cpfs = [line for each in self._cpfs() for line in each.splitlines()]
        reward = self._reward()
        preconditions = [line for each in self._preconditions() for line in each.splitlines()]
        declarations = list(self._declarations())
        types = list(self._types())
        yield from _comment(self.model.domain.doc)
        given = changed(self.words.given)
        yield from _comment("\n".join(f"{n} was called {old}." for n, old in given.items()))
        yield f"domain {self._domain_name} {{"
        yield "  requirements = { reward-deterministic };"
        if types:
            yield from _block("types", types)
        yield from _block("pvariables", declarations)
        yield from _block("cpfs", cpfs)
        yield f"  reward = {indent(reward, '    ').lstrip()};"
        yield from _block("action-preconditions", preconditions)
        yield "}"

    def _types(self) -> Iterator[str]:
        for name in self.words.classes:
            yield f"{self.names[f'class {name}']} : object;"
        for action, outcomes in self._drawing():
            values = ", ".join(f"@{self._value(action, outcome)}" for _, outcome in outcomes)
            yield f"{self.names[f'outcomes {action.name}']} : {{{values}}};"

    def _drawing(self) -> Iterator[tuple[Action, list[tuple[int, Outcome]]]]:
        """The actions of which an outcome is drawn: those that have more than one."""
        for action in self.model.actions:
            outcomes = self.model.outcomes(action)
            if len(outcomes) > 1:
                yield action, outcomes

    def _value(self, action: Action, outcome: Outcome) -> str:
        return self.names[drawn(action, outcome).predicate]

    def _declarations(self) -> Iterator[str]:
        model, declaration = self.model, self.words.declaration
        constant = "non-fluent, bool, default = false"
        changing = "state-fluent, bool, default = false"
        types = {each.name: each.type for each in model.objects}
        for name in self.words.types:
            yield declaration(f"is {name}", [[name]], constant)
        for name in self.words.named:
            yield declaration(f"the {name}", [[types[name]]], constant)
        for predicate in model.static:
            yield declaration(predicate.name, predicate.arguments, constant)
        for action, outcomes in self._drawing():
            of = {v.name: v.types for v in action.parameters}
            per = [of[name] for name in action.rules[0].per]
            for _, outcome in outcomes:
                key = f"chance {action.name} {outcome.name}"
                yield declaration(key, per, "non-fluent, real, default = 0.0")
        for predicate in model.dynamic:
            yield declaration(predicate.name, predicate.arguments, changing)
        for flag in model.flags:
            yield declaration(flag, [], changing)
        if model.two_phases:
            for action in model.actions:
                yield declaration(f"doing {action.name}", _ranges(action), changing)
        for action, outcomes in self._drawing():
            kind = self.names[f"outcomes {action.name}"]
            what = f"interm-fluent, {kind}"
            if model.two_phases:
                what = f"state-fluent, {kind}, default = @{self._value(action, outcomes[-1][1])}"
            yield declaration(f"outcome {action.name}", [], what)
        for action in model.actions:
            what = "action-fluent, bool, default = false"
            yield declaration(f"act {action.name}", _ranges(action), what)

    # ---------------------------------------------------------------------------------------- cpfs

    def _cpfs(self) -> Iterator[str]:
        model, words = self.model, self.words
        for predicate in model.dynamic:
            own, after = model.after(predicate)
            atom = Atom(predicate.name, tuple(Variable(v.name) for v in own))
            with words.declared(own):
                yield f"{words.atom(atom, primed=True)} = {_inside(words.formula(after))};"
        some = words.formula(model.some)
        for flag in model.flags:
            name = self.names[flag]
            yield f"{name}' = {_inside(self._next(flag, name, some))};"
        if model.two_phases:
            for action in model.actions:
                with words.declared(action.parameters):
                    act = words.atom(model.instance(action, "act"))
                    doing = words.atom(model.instance(action, "doing"))
                    name, bracket, rest = doing.partition("(")
                    yield f"{name}'{bracket}{rest} = {act};"
        for action, outcomes in self._drawing():
            rows = ",\n".join(
                f"@{self._value(action, outcome)} : {self._chance(action, outcome)}"
                for _, outcome in outcomes
            )
            kind = self.names[f"outcomes {action.name}"]
            table = f"\n  Discrete({kind},\n{indent(rows, '    ')})\n "
            last = f"@{self._value(action, outcomes[-1][1])}"
            done = words.formula(model.does(action, "act"))
            prime = "'" if model.two_phases else ""
            yield f"{self.names[f'outcome {action.name}']}{prime} = {when(done, table, last)};"

    def _next(self, flag: str, name: str, some: str) -> str:
        if flag == APPLYING:
            return some
        if flag == APPLIED:
            return self.names[APPLYING]
        if flag == PLAYED:
            return infix("|", [name, some])
        assert flag == STOPPED
        step = self.names[APPLYING] if self.model.two_phases else some
        stops = when(step, f"Bernoulli({number(self.model.stop)})", "KronDelta(false)")
        return when(name, "KronDelta(true)", stops)

    def _chance(self, action: Action, outcome: Outcome) -> str:
        """The probability of an outcome of the one instance of an action that is executed."""
        (rule,) = action.rules
        key = f"chance {action.name} {outcome.name}"
        if not rule.per:
            return self.names[key]
        words = self.words
        with words.declared(self.model.spread(action)) as (listed, _):
            act = words.atom(self.model.instance(action, "act"))
            chance = words.atom(Atom(key, tuple(map(Variable, rule.per))))
            return f"(sum_{{{listed}}} [{act} * {chance}])"

    # ------------------------------------------------------------------ rewards and preconditions

    def _reward(self) -> str:
        model, words = self.model, self.words
        terms = [(value, words.formula(where)) for value, where in model.payments()]
        taken, states = model.state_payments()
        if states:
            # Where it is over, no step is taken.
            sums = total((value, self._bindings(each)) for value, each in states)
            terms.append((1.0, f"{words.formula(taken)} * {sums}"))
        for value, where in model.ends():
            if model.two_phases:
                condition = words.formula(conjunction([Atom(APPLIED), where]))
            else:
                now, then = words.formula(model.some), words.formula(where, primed=True)
                condition = infix("^", [now, then])
            terms.append((value, condition))
        return total(terms)

    def _bindings(self, reward: StateReward) -> str:
        """For how many bindings of its variables the condition of a reward holds."""
        if not reward.variables:
            return "1.0" if reward.condition == TRUE else self.words.formula(reward.condition)
        with self.words.declared(reward.variables) as (listed, guard):
            condition = conjunction([guard, reward.condition])
            held = "1.0" if condition == TRUE else self.words.formula(condition)
            return f"(sum_{{{listed}}} [{held}])"

    def _preconditions(self) -> Iterator[str]:
        """Where each action applies, and that one is executed where one applies."""
        model = self.model
        for action in model.actions:
            guards = [model.guard(v.types, Variable(v.name)) for v in action.parameters]
            condition = conjunction([*guards, action.rules[0].condition])
            if condition == TRUE:
                continue
            implied = Implies(model.instance(action, "act"), condition)
            whole = ForAll(model.spread(action), implied) if action.parameters else implied
            yield f"{self.words.formula(whole)};"
        idle = disjunction([Atom(APPLYING) if model.two_phases else FALSE, model.over])
        if idle != FALSE:
            yield f"{self.words.formula(Implies(model.some, negation(idle)))};"
        some = disjunction([model.some, idle, negation(model.applies)])
        yield f"{self.words.formula(some)};"

    # ------------------------------------------------------------------------------------ instance

    def _instance(self) -> Iterator[str]:
        model, name = self.model, self._name
        objects = [
            f"{self.names[f'class {each}']} : {{{', '.join(members)}}};"
            for each in self.words.classes
            if (members := self._members(each))
        ]
        constant = list(self._constant())
        yield from _comment(model.problem.doc)
        yield f"non-fluents nf_{name} {{"
        yield f"  domain = {self._domain_name};"
        if objects:
            yield from _block("objects", objects)
        if constant:
            yield from _block("non-fluents", constant)
        yield "}"
        yield f"instance {name} {{"
        yield f"  domain = {self._domain_name};"
        yield f"  non-fluents = nf_{name};"
        changing = {predicate.name for predicate in model.dynamic}
        init = [
            self.words.assignment(atom.predicate, atom.arguments, "true")
            for atom in sorted(set(model.problem.init))
            if atom.predicate in changing
        ]
        yield from _block("init-state", init or [self._nothing()])
        yield "  max-nondef-actions = 1;"
        yield f"  horizon = {model.horizon};"
        yield f"  discount = {number(model.discount)};"
        yield "}"

    def _constant(self) -> Iterator[str]:
        """What holds in every state, and the probabilities of outcomes."""
        model, assignment = self.model, self.words.assignment
        for type_ in self.words.types:
            for member in model.members[type_]:
                yield assignment(f"is {type_}", [member], "true")
        for name in self.words.named:
            yield assignment(f"the {name}", [name], "true")
        static = {predicate.name for predicate in model.static}
        for atom in sorted(set(model.problem.init)):
            if atom.predicate in static:
                yield assignment(atom.predicate, atom.arguments, "true")
        for action, outcomes in self._drawing():
            for values, row in model.chances[action.name].items():
                for index, outcome in outcomes:
                    key = f"chance {action.name} {outcome.name}"
                    yield assignment(key, values, number(row[index]))

    def _nothing(self) -> str:
        """Something that is false at first: a list of what is true must not be empty."""
        model = self.model
        if model.flags:
            return self.words.assignment(model.flags[0], (), "false")
        predicate = model.dynamic[0]
        some = [
            next(name for each in types for name in model.members[each])
            for types in predicate.arguments
        ]
        return self.words.assignment(predicate.name, some, "false")


def _ranges(action: Action) -> list[tuple[str, ...]]:
    return [variable.types for variable in action.parameters]


def _block(head: str, lines: list[str]) -> Iterator[str]:
    yield f"  {head} {{"
    for line in lines:
        yield f"    {line}"
    yield "  };"


def _inside(text: str) -> str:
    return indent(text, "  ").lstrip()


def _comment(text: str) -> Iterator[str]:
    for line in text.splitlines():
        yield f"// {line}".rstrip()
