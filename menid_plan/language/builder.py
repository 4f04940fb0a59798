"""What Lark calls to make the nodes of `syntax` from a rule's children."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from menid_plan.language.syntax import (
    MAX_NESTING,
    Action,
    Arithmetic,
    Atom,
    Attribute,
    BareName,
    BlockRow,
    Conditional,
    Conjunction,
    Constants,
    Context,
    Count,
    DeadEnd,
    Derived,
    Discount,
    Disjunction,
    Domain,
    Environment,
    Equality,
    Exists,
    File,
    Forall,
    ForEach,
    Fraction,
    Goal,
    Horizon,
    Implication,
    Inequality,
    Init,
    Minus,
    Negated,
    Negation,
    Nested,
    NestingError,
    Number,
    ObjectRange,
    Objects,
    Observed,
    Outcomes,
    Param,
    ParamName,
    Parenthesised,
    Predicate,
    Probabilities,
    Problem,
    Reference,
    Row,
    Rule,
    StateReward,
    Token,
    Truth,
    Types,
    VariableGroup,
)

Children: TypeAlias = list[Any]


class Builder:
    """What Lark calls with a rule's children to get its node: an attribute for each rule.

    Rules that list things (`names`, `items`, ...) give the list; the others the class of their name.
    """

    names = names_list = items = literals = attributes = object_names = staticmethod(
        lambda children: children
    )
    variables = type_unions = type_union = references = atoms = names
    type_name = comparison = staticmethod(lambda children: children[0])
    parameters = staticmethod(lambda children: children[0] or [])

    def __init__(self) -> None:
        plain: list[Callable[..., object]] = [
            Number, ParamName, Fraction, Parenthesised, BareName, Equality, Inequality, Truth,
            Negated, Conditional, ForEach, Row, Reference, ObjectRange, Types, Attribute, Param,
            Environment, Goal, Horizon, Discount, DeadEnd,
        ]  # fmt: skip
        for node in plain:
            self._plain(node)
        for nested in (Minus, Arithmetic, Negation, Implication, Exists, Forall, Count):
            setattr(self, _rule_name(nested), _nested(nested))

    def _plain(self, node: Callable[..., object]) -> None:
        setattr(self, _rule_name(node), lambda children: node(*children))

    conjunction = staticmethod(lambda children: _checked(Conjunction(children), children))
    disjunction = staticmethod(lambda children: _checked(Disjunction(children), children))

    @staticmethod
    def atom(children: Children) -> Atom:
        return Atom(children[0], (children[1] if len(children) > 1 else None) or [])

    @staticmethod
    def variable_group(children: Children) -> VariableGroup:
        return VariableGroup(children[:-1], children[-1])

    @staticmethod
    def context(children: Children) -> Context:
        match children:
            case [Token() as otherwise]:
                return Context(otherwise, [], None)
            case [references]:
                return Context(None, references, None)
            case [references, condition]:
                return Context(None, references or [], condition)
        raise AssertionError(children)

    @staticmethod
    def outcomes(children: Children) -> Outcomes:
        return Outcomes(children[0], children[1], children[2:])

    @staticmethod
    def block_row(children: Children) -> BlockRow:
        return BlockRow(children[0], children[1:])

    @staticmethod
    def probabilities(children: Children) -> Probabilities:
        return Probabilities(children[0], children[1], children[2], children[3:])

    @staticmethod
    def observed(children: Children) -> Observed:
        return Observed(children[0], children[1], children[2], children[3:])

    @staticmethod
    def rule(children: Children) -> Rule:
        keyword, name, per, context, outcomes, *blocks = children
        return Rule(keyword, name, per, context or Context(None, [], None), outcomes, blocks)

    @staticmethod
    def action(children: Children) -> Action:
        keyword, name, parameters, cost, *rules = children
        return Action(keyword, name, parameters or [], cost, rules)

    @staticmethod
    def constants(children: Children) -> Constants:
        return Constants(children[0], children[1], children[2], children[3] or [])

    @staticmethod
    def objects(children: Children) -> Objects:
        return Objects(children[0], children[1], children[2], children[3] or [])

    @staticmethod
    def predicate(children: Children) -> Predicate:
        return Predicate(children[0], children[1], children[2] or [])

    @staticmethod
    def derived(children: Children) -> Derived:
        return Derived(children[0], children[1], children[2] or [], children[3])

    @staticmethod
    def state_reward(children: Children) -> StateReward:
        return StateReward(children[0], children[1], children[2] or [], children[3])

    @staticmethod
    def init(children: Children) -> Init:
        return Init(children[0], children[1])

    @staticmethod
    def domain(children: Children) -> Domain:
        return Domain(children[0], children[1], children[2:])

    @staticmethod
    def problem(children: Children) -> Problem:
        return Problem(children[0], children[1], children[2], children[3:])

    @staticmethod
    def file(children: Children) -> File:
        return File(children[0], children[1])


def _rule_name(node: Callable[..., object]) -> str:
    name: str = node.__name__
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).lstrip("_")


def _nested(node: Callable[..., Nested]) -> Callable[[Children], Nested]:
    return lambda children: _checked(node(*children), children)


def _checked(node: Nested, children: Children) -> Nested:
    node.depth = 1 + max(getattr(child, "depth", 0) for child in children)
    if node.depth > MAX_NESTING:
        raise NestingError(node)
    return node
