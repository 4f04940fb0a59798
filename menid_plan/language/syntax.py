"""The syntax tree: one class for each rule of ``grammar/menid.lark`` that has a name of its own.

Nodes hold tokens and other nodes, in the order of the grammar; what a rule lists (names, rows,
variables) is a plain list. Nothing here is checked: the tree says what was written, not whether it
makes sense. A node knows its place through its tokens (`extent`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

MAX_NESTING = 100


class Token:
    """A word, number or sign of a text, with the offsets of its characters."""

    __slots__ = ("end", "index", "start", "type", "value")

    # Lark looks for these when it makes the token that ends the input.
    line = column = end_line = end_column = start_pos = end_pos = None

    def __init__(self, type_: str, value: str, start: int, end: int, index: int) -> None:
        self.type = type_
        self.value = value
        self.start = start
        self.end = end
        self.index = index

    def __repr__(self) -> str:
        return f"Token({self.type}, {self.value!r}, {self.start})"


class NestingError(Exception):
    """A formula or expression is nested more than MAX_NESTING levels deep."""

    def __init__(self, node: Nested) -> None:
        super().__init__(node)
        self.node = node


class Nested:
    """A node that may contain its like; ``depth`` counts the levels below and with it."""

    __slots__ = ("depth",)

    depth: int


# ------------------------------------------------------------------------------------ expressions


@dataclass(slots=True)
class Number:
    token: Token


@dataclass(slots=True)
class ParamName:
    token: Token


@dataclass
class Minus(Nested):
    __slots__ = ("operand", "sign")
    sign: Token
    operand: Expression


@dataclass
class Arithmetic(Nested):
    __slots__ = ("left", "operator", "right")
    left: Expression
    operator: Token
    right: Expression


Expression: TypeAlias = Number | ParamName | Minus | Arithmetic


@dataclass(slots=True)
class Fraction:
    numerator: Token
    denominator: Token


@dataclass(slots=True)
class Parenthesised:
    expression: Expression


@dataclass(slots=True)
class BareName:
    """A name in a row without parentheses: a param's cell, or an atom without arguments."""

    token: Token


Cell: TypeAlias = Number | Fraction | Parenthesised | BareName


# --------------------------------------------------------------------------------------- formulas


@dataclass(slots=True)
class VariableGroup:
    names: list[Token]
    types: list[Token]


@dataclass(slots=True)
class Atom:
    name: Token
    arguments: list[Token]


@dataclass(slots=True)
class Equality:
    left: Token
    right: Token


@dataclass(slots=True)
class Inequality:
    left: Token
    right: Token


@dataclass(slots=True)
class Truth:
    token: Token


@dataclass
class Negation(Nested):
    __slots__ = ("formula",)
    formula: Formula


@dataclass
class Conjunction(Nested):
    __slots__ = ("formulas",)
    formulas: list[Formula]


@dataclass
class Disjunction(Nested):
    __slots__ = ("formulas",)
    formulas: list[Formula]


@dataclass
class Implication(Nested):
    __slots__ = ("left", "right")
    left: Formula
    right: Formula


@dataclass
class Exists(Nested):
    __slots__ = ("formula", "variables")
    variables: list[VariableGroup]
    formula: Formula


@dataclass
class Forall(Nested):
    __slots__ = ("formula", "variables")
    variables: list[VariableGroup]
    formula: Formula


@dataclass
class Count(Nested):
    __slots__ = ("comparison", "formula", "number", "variables")
    variables: list[VariableGroup]
    formula: Formula
    comparison: Token
    number: Token


Formula: TypeAlias = (
    Atom
    | Equality
    | Inequality
    | Truth
    | Negation
    | Conjunction
    | Disjunction
    | Implication
    | Exists
    | Forall
    | Count
)


# ------------------------------------------------------------------------------ rules and actions


@dataclass(slots=True)
class Negated:
    atom: Atom


@dataclass(slots=True)
class Conditional:
    condition: Formula
    literals: list[Atom | Negated]


@dataclass(slots=True)
class ForEach:
    variables: list[VariableGroup]
    condition: Formula
    literals: list[Atom | Negated]


Effect: TypeAlias = Atom | Negated | Conditional | ForEach
# A Token is `nothing` or a comma.
Item: TypeAlias = Cell | Effect | Token


@dataclass(slots=True)
class Row:
    name: Token
    items: list[Item]
    reward: Expression | None


@dataclass(slots=True)
class Outcomes:
    keyword: Token
    environments: list[Token]
    rows: list[Row]


@dataclass(slots=True)
class BlockRow:
    name: Token
    cells: list[Cell]


@dataclass(slots=True)
class Probabilities:
    keyword: Token
    environments: list[Token]
    values: list[Token] | None
    rows: list[BlockRow]


@dataclass(slots=True)
class Observed:
    keyword: Token
    environments: list[Token]
    values: list[Token] | None
    rows: list[BlockRow]


Block: TypeAlias = Probabilities | Observed


@dataclass(slots=True)
class Reference:
    keyword: Token
    variables: list[VariableGroup]
    formula: Formula


@dataclass(slots=True)
class Context:
    """Where a rule covers: ``otherwise`` (a token), or references and a condition."""

    otherwise: Token | None
    references: list[Reference]
    condition: Formula | None


@dataclass(slots=True)
class Rule:
    keyword: Token
    name: Token
    per: list[Token] | None
    context: Context
    outcomes: Outcomes
    blocks: list[Block]


@dataclass(slots=True)
class Action:
    keyword: Token
    name: Token
    parameters: list[VariableGroup]
    cost: Expression | None
    rules: list[Rule]


# ----------------------------------------------------------------------------------- declarations


@dataclass(slots=True)
class Types:
    keyword: Token
    names: list[Token]
    parent: Token | None


@dataclass(slots=True)
class ObjectRange:
    first: Token
    last: Token


@dataclass(slots=True)
class Attribute:
    name: Token
    sign: Token | None
    number: Token


@dataclass(slots=True)
class Constants:
    keyword: Token
    names: list[Token | ObjectRange]
    type: Token
    attributes: list[Attribute]


@dataclass(slots=True)
class Objects:
    keyword: Token
    names: list[Token | ObjectRange]
    type: Token
    attributes: list[Attribute]


@dataclass(slots=True)
class Param:
    keyword: Token
    name: Token
    value: Expression


@dataclass(slots=True)
class Environment:
    keyword: Token
    name: Token
    role: Token


@dataclass(slots=True)
class Predicate:
    keyword: Token
    name: Token
    arguments: list[list[Token]]


@dataclass(slots=True)
class Derived:
    keyword: Token
    name: Token
    parameters: list[VariableGroup]
    formula: Formula


@dataclass(slots=True)
class StateReward:
    keyword: Token
    reward: Expression
    variables: list[VariableGroup]
    condition: Formula


@dataclass(slots=True)
class Init:
    keyword: Token
    atoms: list[Atom]


@dataclass(slots=True)
class Goal:
    keyword: Token
    formula: Formula
    reward: Expression | None


@dataclass(slots=True)
class Horizon:
    keyword: Token
    number: Token


@dataclass(slots=True)
class Discount:
    keyword: Token
    number: Token


@dataclass(slots=True)
class DeadEnd:
    keyword: Token
    reward: Expression


DomainItem: TypeAlias = (
    Types | Constants | Param | Environment | Predicate | Derived | StateReward | Action
)
ProblemItem: TypeAlias = Param | Objects | Init | Goal | Horizon | Discount | DeadEnd


@dataclass(slots=True)
class Domain:
    keyword: Token
    name: Token
    items: list[DomainItem]


@dataclass(slots=True)
class Problem:
    keyword: Token
    name: Token
    domain: Token
    items: list[ProblemItem]


@dataclass(slots=True)
class File:
    domain: Domain | None
    problem: Problem | None


# ------------------------------------------------------------------------- from children to nodes

Children: TypeAlias = list[Any]


class Builder:
    """What Lark calls with a rule's children to get its node: an attribute for each rule.

    Rules that list things (`names`, `items`, ...) give the list; the others the class of their name.
    """

    names = names_list = items = literals = attributes = object_names = staticmethod(
        lambda children: children
    )
    variables = type_unions = type_union = references = names
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
        return Init(children[0], children[1:])

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


def extent(node: Any) -> tuple[int, int]:
    """The offsets of the first character of a node (or list, or token) and after its last."""
    first, last = _end_token(node, 0), _end_token(node, -1)
    if first is None or last is None:
        raise ValueError(f"no token in {node!r}")
    return first.start, last.end


def _end_token(node: Any, end: int) -> Token | None:
    """The first (``end=0``) or last (``end=-1``) token of a node; None if it has none."""
    if isinstance(node, Token):
        return node
    if node is None:
        return None
    children = node if isinstance(node, list) else _children(node)
    for child in children if end == 0 else reversed(children):
        token = _end_token(child, end)
        if token is not None:
            return token
    return None


def _children(node: Any) -> list[Any]:
    return [getattr(node, name) for name in node.__dataclass_fields__]
