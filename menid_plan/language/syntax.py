"""The syntax tree: one class for each rule of ``grammar/menid.lark`` that has a name of its own.

Nodes hold tokens and other nodes, in the order of the grammar; what a rule lists (names, rows,
variables) is a plain list. Nothing here is checked: the tree says what was written, not whether it
makes sense. A node knows its place through its tokens (`extent`). Nodes are not compared or printed:
leaving that out of their classes makes the start-up shorter.
"""

from __future__ import annotations

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


@dataclass(slots=True, eq=False, repr=False)
class Number:
    token: Token


@dataclass(slots=True, eq=False, repr=False)
class ParamName:
    token: Token


@dataclass(eq=False, repr=False)
class Minus(Nested):
    __slots__ = ("operand", "sign")
    sign: Token
    operand: Expression


@dataclass(eq=False, repr=False)
class Arithmetic(Nested):
    __slots__ = ("left", "operator", "right")
    left: Expression
    operator: Token
    right: Expression


Expression: TypeAlias = Number | ParamName | Minus | Arithmetic


@dataclass(slots=True, eq=False, repr=False)
class Fraction:
    numerator: Token
    denominator: Token


@dataclass(slots=True, eq=False, repr=False)
class Parenthesised:
    expression: Expression


@dataclass(slots=True, eq=False, repr=False)
class BareName:
    """A name in a row without parentheses: a param's cell, or an atom without arguments."""

    token: Token


Cell: TypeAlias = Number | Fraction | Parenthesised | BareName


# --------------------------------------------------------------------------------------- formulas


@dataclass(slots=True, eq=False, repr=False)
class VariableGroup:
    names: list[Token]
    types: list[Token]


@dataclass(slots=True, eq=False, repr=False)
class Atom:
    name: Token
    arguments: list[Token]


@dataclass(slots=True, eq=False, repr=False)
class Equality:
    left: Token
    right: Token


@dataclass(slots=True, eq=False, repr=False)
class Inequality:
    left: Token
    right: Token


@dataclass(slots=True, eq=False, repr=False)
class Truth:
    token: Token


@dataclass(eq=False, repr=False)
class Negation(Nested):
    __slots__ = ("formula",)
    formula: Formula


@dataclass(eq=False, repr=False)
class Conjunction(Nested):
    __slots__ = ("formulas",)
    formulas: list[Formula]


@dataclass(eq=False, repr=False)
class Disjunction(Nested):
    __slots__ = ("formulas",)
    formulas: list[Formula]


@dataclass(eq=False, repr=False)
class Implication(Nested):
    __slots__ = ("left", "right")
    left: Formula
    right: Formula


@dataclass(eq=False, repr=False)
class Exists(Nested):
    __slots__ = ("formula", "variables")
    variables: list[VariableGroup]
    formula: Formula


@dataclass(eq=False, repr=False)
class Forall(Nested):
    __slots__ = ("formula", "variables")
    variables: list[VariableGroup]
    formula: Formula


@dataclass(eq=False, repr=False)
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


@dataclass(slots=True, eq=False, repr=False)
class Negated:
    atom: Atom


@dataclass(slots=True, eq=False, repr=False)
class Conditional:
    condition: Formula
    literals: list[Atom | Negated]


@dataclass(slots=True, eq=False, repr=False)
class ForEach:
    variables: list[VariableGroup]
    condition: Formula
    literals: list[Atom | Negated]


Effect: TypeAlias = Atom | Negated | Conditional | ForEach
# A Token is `nothing` or a comma.
Item: TypeAlias = Cell | Effect | Token


@dataclass(slots=True, eq=False, repr=False)
class Row:
    name: Token
    items: list[Item]
    reward: Expression | None


@dataclass(slots=True, eq=False, repr=False)
class Outcomes:
    keyword: Token
    environments: list[Token]
    rows: list[Row]


@dataclass(slots=True, eq=False, repr=False)
class BlockRow:
    name: Token
    cells: list[Cell]


@dataclass(slots=True, eq=False, repr=False)
class Probabilities:
    keyword: Token
    environments: list[Token]
    values: list[Token] | None
    rows: list[BlockRow]


@dataclass(slots=True, eq=False, repr=False)
class Observed:
    keyword: Token
    environments: list[Token]
    values: list[Token] | None
    rows: list[BlockRow]


Block: TypeAlias = Probabilities | Observed


@dataclass(slots=True, eq=False, repr=False)
class Reference:
    keyword: Token
    variables: list[VariableGroup]
    formula: Formula


@dataclass(slots=True, eq=False, repr=False)
class Context:
    """Where a rule covers: ``otherwise`` (a token), or references and a condition."""

    otherwise: Token | None
    references: list[Reference]
    condition: Formula | None


@dataclass(slots=True, eq=False, repr=False)
class Rule:
    keyword: Token
    name: Token
    per: list[Token] | None
    context: Context
    outcomes: Outcomes
    blocks: list[Block]
    whole: bool = True  # False if rows or conditions that do not parse were left out


@dataclass(slots=True, eq=False, repr=False)
class Action:
    keyword: Token
    name: Token
    parameters: list[VariableGroup]
    cost: Expression | None
    rules: list[Rule]


# ----------------------------------------------------------------------------------- declarations


@dataclass(slots=True, eq=False, repr=False)
class Types:
    keyword: Token
    names: list[Token]
    parent: Token | None


@dataclass(slots=True, eq=False, repr=False)
class ObjectRange:
    first: Token
    last: Token


@dataclass(slots=True, eq=False, repr=False)
class Attribute:
    name: Token
    sign: Token | None
    number: Token


@dataclass(slots=True, eq=False, repr=False)
class Constants:
    keyword: Token
    names: list[Token | ObjectRange]
    type: Token
    attributes: list[Attribute]


@dataclass(slots=True, eq=False, repr=False)
class Objects:
    keyword: Token
    names: list[Token | ObjectRange]
    type: Token
    attributes: list[Attribute]


@dataclass(slots=True, eq=False, repr=False)
class Param:
    keyword: Token
    name: Token
    value: Expression


@dataclass(slots=True, eq=False, repr=False)
class Environment:
    keyword: Token
    name: Token
    role: Token


@dataclass(slots=True, eq=False, repr=False)
class Predicate:
    keyword: Token
    name: Token
    arguments: list[list[Token]]


@dataclass(slots=True, eq=False, repr=False)
class Derived:
    keyword: Token
    name: Token
    parameters: list[VariableGroup]
    formula: Formula


@dataclass(slots=True, eq=False, repr=False)
class StateReward:
    keyword: Token
    reward: Expression
    variables: list[VariableGroup]
    condition: Formula


@dataclass(slots=True, eq=False, repr=False)
class Init:
    keyword: Token
    atoms: list[Atom]


@dataclass(slots=True, eq=False, repr=False)
class Goal:
    keyword: Token
    formula: Formula
    reward: Expression | None


@dataclass(slots=True, eq=False, repr=False)
class Horizon:
    keyword: Token
    number: Token


@dataclass(slots=True, eq=False, repr=False)
class Discount:
    keyword: Token
    number: Token


@dataclass(slots=True, eq=False, repr=False)
class DeadEnd:
    keyword: Token
    reward: Expression


DomainItem: TypeAlias = (
    Types | Constants | Param | Environment | Predicate | Derived | StateReward | Action
)
ProblemItem: TypeAlias = Param | Objects | Init | Goal | Horizon | Discount | DeadEnd


@dataclass(slots=True, eq=False, repr=False)
class Domain:
    keyword: Token
    name: Token
    items: list[DomainItem]


@dataclass(slots=True, eq=False, repr=False)
class Problem:
    keyword: Token
    name: Token
    domain: Token
    items: list[ProblemItem]


@dataclass(slots=True, eq=False, repr=False)
class File:
    domain: Domain | None
    problem: Problem | None


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
