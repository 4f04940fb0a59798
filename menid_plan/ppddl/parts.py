"""Terms, formulas, numbers and effects of PPDDL, read with what is wrong with them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from fractions import Fraction

from menid_plan.model.domain import OBJECT, Object
from menid_plan.model.formulas import (
    TRUE,
    And,
    Atom,
    Constant,
    Equality,
    Exists,
    ForAll,
    Formula,
    Implies,
    Not,
    Or,
    Term,
    TypedVariable,
    Variable,
)
from menid_plan.model.rules import Literal
from menid_plan.ppddl.syntax import List, Node, Word
from menid_plan.ppddl.task import Chance, Effect, Every, Pay, Together, When
from menid_plan.source import Diagnostic, SourceFile, Span

REWARD, STEPS, ACHIEVED = "reward", "total-time", "goal-achieved"

# What the language has and is not read, by its word.
REFUSED = {
    ":derived": "derived predicates are not part of PPDDL",
    ":axiom": "axioms are not part of PPDDL",
    ":durative-action": "durative actions",
    ":observation": "partial observability",
    "oneof": "`oneof`: an outcome without a probability",
    "unknown": "partial observability",
    "assign": "numeric fluents, other than a metric that grows and shrinks",
    "scale-up": "numeric fluents, other than a metric that grows and shrinks",
    "scale-down": "numeric fluents, other than a metric that grows and shrinks",
}
_NUMERIC = "numeric fluents in conditions"
# How much more than 1 probabilities may add up to.
_TOLERANCE = Fraction(1, 10**6)


# So many faults are told; a text with more is no PPDDL.
MOST_FOUND = 100


class Enough(Exception):  # noqa: N818 - it never leaves this package
    """There are too many faults for the rest to be worth reading."""


class Wrong(Exception):  # noqa: N818 - it never leaves this module
    """A part can't be read; the diagnostic says why."""

    def __init__(self, code: str, message: str, node: Node, hint: str | None = None) -> None:
        super().__init__(message)
        self.code, self.message, self.node, self.hint = code, message, node, hint


def name_in(node: Node, what: str = "a name") -> Word:
    """The name that a node is."""
    if not isinstance(node, Word) or node.kind != "NAME":
        raise Wrong("P101", f"expected {what}, found {shown(node)}", node)
    return node


def list_in(node: Node, what: str) -> List:
    """The list that a node is."""
    if not isinstance(node, List):
        raise Wrong("P101", f"expected {what}, found {shown(node)}", node)
    return node


def demand(node: List, number: int, form: str) -> None:
    """Demand that a list has so many items behind its head."""
    if len(node.items) != number + 1:
        raise Wrong("P103", f"expected `{form}`, found {_counted(len(node.items) - 1)}", node)


def _counted(number: int) -> str:
    return f"{number or 'no'} part{'' if number == 1 else 's'} behind the first"


def shown(node: Node) -> str:
    """What a message calls a node."""
    if isinstance(node, Word):
        return f"`{node.text}`"
    return f"`({node.head} ...)`" if node.head else "`(...)`"


class Reader:
    """Reads parts of one text, and goes on with the next where one is wrong."""

    def __init__(self, source: SourceFile, diagnostics: list[Diagnostic]) -> None:
        self.source = source
        self.diagnostics = diagnostics

    def span(self, node: Node) -> Span:
        """The place of a node: of a list, its parenthesis and first word."""
        if isinstance(node, Word):
            return Span(self.source, node.start, node.end)
        first = node.items[0] if node.items else None
        end = first.end if isinstance(first, Word) else node.start + 1
        return Span(self.source, node.start, end)

    @contextmanager
    def part(self) -> Iterator[None]:
        """Read a part; what is wrong with it is recorded, and the rest of it left out."""
        try:
            yield
        except Wrong as wrong:
            span = self.span(wrong.node)
            if len(self.diagnostics) >= MOST_FOUND:
                text = f"more than {MOST_FOUND} faults: the rest is not read"
                self.diagnostics.append(Diagnostic("error", "P004", text, span))
                raise Enough from None
            self.diagnostics.append(
                Diagnostic("error", wrong.code, wrong.message, span, wrong.hint)
            )

    def warning(self, code: str, message: str, node: Node) -> None:
        """Record a warning."""
        self.diagnostics.append(Diagnostic("warning", code, message, self.span(node)))

    def unknown(self, kind: str, word: Word, known: Collection[str]) -> Wrong:
        """That a name is not declared, with the one that it looks like."""
        close = get_close_matches(word.text, list(known)[:5000], n=1)
        hint = f"did you mean `{close[0]}`?" if close else None
        return Wrong("P201", f"unknown {kind} `{word.text}`", word, hint)


Scope = Mapping[str, tuple[str, ...]]
"""The types of the variables that are bound."""


class Declared(Reader):
    """Reads what speaks of declared types, objects, predicates and functions."""

    def __init__(self, source: SourceFile, diagnostics: list[Diagnostic]) -> None:
        super().__init__(source, diagnostics)
        self.types: dict[str, str] = {}  # each with its parent
        self.objects: dict[str, str] = {}  # each with its type
        self.predicates: dict[str, tuple[tuple[str, ...], ...]] = {}
        self.functions: dict[str, int] = {}  # each with how many arguments it has

    # ---------------------------------------------------------------------------------- names, types

    def typed(self, items: Sequence[Node], kind: str) -> Iterator[tuple[Word, Node | None]]:
        """Names (or variables) of a typed list, each with what stands behind its `-`, if anything."""
        waiting: list[Word] = []
        rest = iter(items)
        for item in rest:
            if isinstance(item, Word) and item.text == "-":
                type_ = next(rest, None)
                if type_ is None or not waiting:
                    raise Wrong("P101", "expected names, `-`, and a type", item)
                yield from ((word, type_) for word in waiting)
                waiting = []
            elif isinstance(item, Word) and item.kind == kind:
                waiting.append(item)
            else:
                what = "a variable" if kind == "VARIABLE" else "a name"
                raise Wrong("P101", f"expected {what}, found {shown(item)}", item)
        yield from ((word, None) for word in waiting)

    def type_of(self, node: Node | None) -> tuple[str, ...]:
        """The types that a type stands for: itself, or those of an `either`."""
        if node is None:
            return (OBJECT,)
        if isinstance(node, List):
            if node.head != "either" or len(node.items) < 2:
                raise Wrong("P101", f"expected a type, found {shown(node)}", node)
            found = (self._type(name_in(each, "a type")) for each in node.items[1:])
            return tuple(dict.fromkeys(found))
        return (self._type(name_in(node, "a type")),)

    def _type(self, word: Word) -> str:
        if word.text != OBJECT and word.text not in self.types:
            raise self.unknown("type", word, self.types)
        return word.text

    def ancestors(self, name: str) -> Iterator[str]:
        """A type and all those above it."""
        while name != OBJECT:
            yield name
            name = self.types[name]
        yield OBJECT

    def fits(self, given: Sequence[str], asked: Sequence[str]) -> bool:
        """Whether whatever is of one of the given types is of one of those asked for."""
        return all(not set(asked).isdisjoint(self.ancestors(each)) for each in given)

    def variables(
        self, node: Node, scope: Scope
    ) -> tuple[tuple[TypedVariable, ...], dict[str, tuple[str, ...]]]:
        """Declared variables, and the scope with them."""
        found: list[TypedVariable] = []
        inner = dict(scope)
        names: set[str] = set()
        for word, type_ in self.typed(list_in(node, "`(?x - TYPE ...)`").items, "VARIABLE"):
            name = word.text[1:]
            if name in names:
                raise Wrong("P202", f"variable `{word.text}` is declared twice", word)
            names.add(name)
            inner[name] = self.type_of(type_)
            found.append(TypedVariable(name, inner[name]))
        return tuple(found), inner

    def add_objects(self, section: List) -> Iterator[Object]:
        """The objects that a section declares."""
        for word, node in self.typed(section.items[1:], "NAME"):
            types = self.type_of(node)
            if len(types) > 1:
                raise Wrong("P301", f"object `{word.text}` of several types (`either`)", word)
            if self.objects.get(word.text, types[0]) != types[0]:
                raise Wrong("P202", f"object `{word.text}` is declared twice", word)
            if word.text not in self.objects:
                self.objects[word.text] = types[0]
                yield Object(word.text, types[0])

    # -------------------------------------------------------------------------------------- formulas

    def term(self, node: Node, scope: Scope) -> tuple[Term, tuple[str, ...]]:
        """A term and its types."""
        if isinstance(node, Word) and node.kind == "VARIABLE":
            name = node.text[1:]
            if name not in scope:
                raise self.unknown("variable", node, [f"?{each}" for each in scope])
            return Variable(name), scope[name]
        word = name_in(node, "an object or a variable")
        if word.text not in self.objects:
            raise self.unknown("object", word, self.objects)
        return Constant(word.text), (self.objects[word.text],)

    def atom(self, node: Node, scope: Scope) -> Atom:
        """An atom; one without arguments may lack its parentheses."""
        items = node.items if isinstance(node, List) else (node,)
        if not items:
            raise Wrong("P101", "expected an atom, found `()`", node)
        word = name_in(items[0], "a predicate")
        if word.text in REFUSED:
            raise refused(word.text, word)
        if word.text not in self.predicates:
            raise self.unknown("predicate", word, self.predicates)
        asked = self.predicates[word.text]
        if len(asked) != len(items) - 1:
            raise Wrong(
                "P203",
                f"predicate `{word.text}` takes {len(asked)} arguments, not {len(items) - 1}",
                node,
            )
        terms = []
        for each, types in zip(items[1:], asked, strict=True):
            term, given = self.term(each, scope)
            if not self.fits(given, types):
                raise Wrong(
                    "P204", f"{shown(each)} is of type {' or '.join(given)}; `{word.text}` takes"
                    f" {' or '.join(types)} there", each,
                )  # fmt: skip
            terms.append(term)
        return Atom(word.text, tuple(terms))

    def formula(self, node: Node, scope: Scope) -> Formula:
        """A condition."""
        if isinstance(node, Word):
            return self.atom(node, scope)
        if not node.items:
            return TRUE
        match node.head:
            case "and":
                return And(tuple(self.formula(each, scope) for each in node.items[1:]))
            case "or":
                return Or(tuple(self.formula(each, scope) for each in node.items[1:]))
            case "not":
                demand(node, 1, "(not FORMULA)")
                return Not(self.formula(node.items[1], scope))
            case "imply":
                demand(node, 2, "(imply FORMULA FORMULA)")
                return Implies(
                    self.formula(node.items[1], scope), self.formula(node.items[2], scope)
                )
            case "exists" | "forall":
                demand(node, 2, f"({node.head} (VARIABLES) FORMULA)")
                variables, inner = self.variables(node.items[1], scope)
                body = self.formula(node.items[2], inner)
                return Exists(variables, body) if node.head == "exists" else ForAll(variables, body)
            case "=":
                demand(node, 2, "(= TERM TERM)")
                for each in node.items[1:]:
                    number = isinstance(each, List) or (
                        isinstance(each, Word) and each.kind == "NUMBER"
                    )
                    if number or (isinstance(each, Word) and each.text in self.functions):
                        raise Wrong("P301", f"not read: {_NUMERIC}", node)
                left, right = (self.term(each, scope)[0] for each in node.items[1:])
                return Equality(left, right)
            case "<" | "<=" | ">" | ">=":
                raise Wrong("P301", f"not read: {_NUMERIC}", node)
        return self.atom(node, scope)

    # --------------------------------------------------------------------------------------- numbers

    def number(self, node: Node) -> Fraction:
        """A number, or what is computed of numbers; it is within the range of double precision."""
        value = self._number(node)
        try:
            lost = value != 0 and float(value) == 0.0
        except OverflowError:
            raise Wrong("P205", "this number is too large", node) from None
        if lost:
            raise Wrong("P205", "this number is too small to be told from 0", node)
        return value

    def _number(self, node: Node) -> Fraction:
        if isinstance(node, Word) and node.kind == "NUMBER":
            try:
                return Fraction(node.text if node.text[0] not in "./" else f"0{node.text}")
            except (ValueError, ZeroDivisionError):
                raise Wrong("P205", f"`{node.text}` is no number", node) from None
        if (
            isinstance(node, List)
            and node.head in ("+", "-", "*", "/")
            and len(node.items) in (2, 3)
        ):
            values = [self._number(each) for each in node.items[1:]]
            match node.head, values:
                case "-", [value]:
                    return -value
                case "+", [left, right]:
                    return left + right
                case "-", [left, right]:
                    return left - right
                case "*", [left, right]:
                    return left * right
                case "/", [left, right] if right:
                    return left / right
            raise Wrong("P205", "this has no value", node)
        if isinstance(node, List) and node.head in self.functions:
            raise Wrong("P301", "not read: amounts that depend on numeric fluents", node)
        raise Wrong("P101", f"expected a number, found {shown(node)}", node)

    def fluent(self, node: Node) -> str:
        """The name of a numeric fluent without arguments."""
        items = node.items if isinstance(node, List) else (node,)
        if not items:
            raise Wrong("P101", "expected a numeric fluent, found `()`", node)
        word = name_in(items[0], "a numeric fluent")
        if word.text not in self.functions:
            raise self.unknown("function", word, self.functions)
        if len(items) > 1 or self.functions[word.text]:
            raise Wrong("P301", "not read: numeric fluents with arguments", node)
        return word.text

    # --------------------------------------------------------------------------------------- effects

    def effect(self, node: Node, scope: Scope) -> Effect:
        """An effect."""
        if isinstance(node, Word):
            return Literal(self.atom(node, scope))
        if not node.items:
            return Together(())
        match node.head:
            case "and":
                return Together(tuple(self.effect(each, scope) for each in node.items[1:]))
            case "not":
                demand(node, 1, "(not ATOM)")
                return Literal(self.atom(node.items[1], scope), positive=False)
            case "when":
                demand(node, 2, "(when FORMULA EFFECT)")
                condition = self.formula(node.items[1], scope)
                return When(condition, self.effect(node.items[2], scope))
            case "forall":
                demand(node, 2, "(forall (VARIABLES) EFFECT)")
                variables, inner = self.variables(node.items[1], scope)
                return Every(variables, self.effect(node.items[2], inner))
            case "probabilistic":
                return self._chance(node, scope)
            case "increase" | "decrease":
                demand(node, 2, f"({node.head} FLUENT NUMBER)")
                amount = self.number(node.items[2])
                return Pay(
                    self.fluent(node.items[1]), amount if node.head == "increase" else -amount
                )
        if node.head in REFUSED:
            raise refused(node.head, node)
        return Literal(self.atom(node, scope))

    def _chance(self, node: List, scope: Scope) -> Chance:
        rest = node.items[1:]
        if not rest or len(rest) % 2:
            raise Wrong("P103", "expected `(probabilistic NUMBER EFFECT NUMBER EFFECT ...)`", node)
        choices = []
        for number, effect in zip(rest[::2], rest[1::2], strict=True):
            chance = self.number(number)
            if not 0 <= chance <= 1:
                text = number.text if isinstance(number, Word) else f"{float(chance):.12g}"
                raise Wrong("P206", f"the probability {text} is not between 0 and 1", number)
            choices.append((chance, self.effect(effect, scope)))
        total = sum(chance for chance, _ in choices)
        # Probabilities that were rounded may add up to a little more than 1.
        if total > 1 + _TOLERANCE:
            raise Wrong("P206", f"the probabilities add up to {float(total):.9g}", node)
        if total > 1:
            choices = [(chance / total, effect) for chance, effect in choices]
        return Chance(tuple(choices))


def refused(word: str, node: Node) -> Wrong:
    """That something is not read, by the word that it begins with."""
    return Wrong("P301", f"not read: {REFUSED[word]}", node)
