"""From the lists of a text to a PPDDL domain and problem, with all that is wrong with them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from typing import NamedTuple

from menid_plan.model.domain import OBJECT, Object, Predicate, Type
from menid_plan.model.formulas import (
    TRUE,
    And,
    Atom,
    Constant,
    Equality,
    Exists,
    ForAll,
    Formula,
    GroundAtom,
    Implies,
    Not,
    Or,
    Term,
    TypedVariable,
    Variable,
)
from menid_plan.model.rules import Literal
from menid_plan.ppddl.syntax import List, Node, Word, parse
from menid_plan.ppddl.task import (
    Action,
    Chance,
    Effect,
    Every,
    Pay,
    PddlDomain,
    PddlProblem,
    Together,
    When,
)
from menid_plan.source import Diagnostic, SourceFile, Span, in_order

REWARD, STEPS, ACHIEVED = "reward", "total-time", "goal-achieved"

# What the language has and is not read, by its word.
_REFUSED = {
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
_REQUIREMENTS = frozenset(
    ":strips :typing :equality :negative-preconditions :disjunctive-preconditions"
    " :existential-preconditions :universal-preconditions :quantified-preconditions"
    " :conditional-effects :probabilistic-effects :rewards :mdp :adl :fluents".split()
)


class _Wrong(Exception):  # noqa: N818 - it never leaves this module
    """A part can't be read; the diagnostic says why."""

    def __init__(self, code: str, message: str, node: Node, hint: str | None = None) -> None:
        super().__init__(message)
        self.code, self.message, self.node, self.hint = code, message, node, hint


@dataclass(frozen=True, slots=True)
class ReadResult:
    """What some texts hold; None where there is none, or one with errors."""

    domain: PddlDomain | None
    problem: PddlProblem | None
    diagnostics: tuple[Diagnostic, ...]

    @property
    def has_errors(self) -> bool:
        """Whether any diagnostic is an error."""
        return any(each.is_error for each in self.diagnostics)


class _Definition(NamedTuple):
    source: SourceFile
    name: Word
    sections: tuple[Node, ...]
    whole: List


def read(sources: Iterable[SourceFile], problem: str | None = None) -> ReadResult:
    """Read a domain and a problem from one text, or from two in any order.

    ``problem`` names the one that is read where there are several.
    """
    diagnostics: list[Diagnostic] = []
    found: dict[str, _Definition] = {}
    others: list[str] = []
    last: SourceFile | None = None
    for source in sources:
        lists, wrong = parse(source)
        diagnostics += wrong
        last = source
        reader = _Reader(source, diagnostics)
        for each in lists:
            with reader.part():
                kind, definition = _define(source, each)
                if kind == "problem" and problem not in (None, definition.name.text):
                    others.append(definition.name.text)
                    continue
                if kind in found:
                    hint = "say which one is wanted by its name" if kind == "problem" else None
                    raise _Wrong("P102", f"a second {kind}; one of each is read", each, hint)
                found[kind] = definition
    domain = None
    read_problem = None
    if "domain" in found:
        of_domain = _DomainReader(found["domain"], diagnostics)
        domain = of_domain.domain()
        if "problem" in found:
            read_problem = _ProblemReader(found["problem"], of_domain, diagnostics).problem()
    if last is not None and not diagnostics:
        for kind in ("domain", "problem"):
            if kind not in found:
                message = f"there is no {kind}: expected `(define ({kind} NAME) ...)`"
                if kind == "problem" and others:
                    message = f"there is no problem `{problem}`; there are: {', '.join(others)}"
                span = Span(last, 0, min(1, len(last.text)))
                diagnostics.append(Diagnostic("error", "P101", message, span))
    if any(each.is_error for each in diagnostics):
        domain = read_problem = None
    return ReadResult(domain, read_problem, tuple(in_order(diagnostics)))


def _define(source: SourceFile, each: List) -> tuple[str, _Definition]:
    items = each.items
    form = "`(define (domain NAME) ...)` or `(define (problem NAME) ...)`"
    if each.head != "define" or len(items) < 2 or not isinstance(items[1], List):
        raise _Wrong("P101", f"expected {form}, found {_shown(each)}", each)
    kind = items[1].head
    if kind not in ("domain", "problem") or len(items[1].items) != 2:
        raise _Wrong("P101", f"expected {form}, found {_shown(items[1])}", items[1])
    return kind, _Definition(source, _name(items[1].items[1]), items[2:], each)


def _name(node: Node, what: str = "a name") -> Word:
    if not isinstance(node, Word) or node.kind != "NAME":
        raise _Wrong("P101", f"expected {what}, found {_shown(node)}", node)
    return node


def _list(node: Node, what: str) -> List:
    if not isinstance(node, List):
        raise _Wrong("P101", f"expected {what}, found {_shown(node)}", node)
    return node


def _count(node: List, number: int, form: str) -> None:
    """Demand that a list has so many items behind its head."""
    if len(node.items) != number + 1:
        raise _Wrong("P103", f"expected `{form}`, found {_counted(len(node.items) - 1)}", node)


def _counted(number: int) -> str:
    return f"{number or 'no'} part{'' if number == 1 else 's'} behind the first"


def _shown(node: Node) -> str:
    if isinstance(node, Word):
        return f"`{node.text}`"
    return f"`({node.head} ...)`" if node.head else "`(...)`"


class _Reader:
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
        except _Wrong as wrong:
            self.diagnostics.append(
                Diagnostic("error", wrong.code, wrong.message, self.span(wrong.node), wrong.hint)
            )

    def warning(self, code: str, message: str, node: Node) -> None:
        """Record a warning."""
        self.diagnostics.append(Diagnostic("warning", code, message, self.span(node)))

    def unknown(self, kind: str, word: Word, known: Collection[str]) -> _Wrong:
        """That a name is not declared, with the one that it looks like."""
        close = get_close_matches(word.text, list(known)[:5000], n=1)
        hint = f"did you mean `{close[0]}`?" if close else None
        return _Wrong("P201", f"unknown {kind} `{word.text}`", word, hint)


Scope = Mapping[str, tuple[str, ...]]
"""The types of the variables that are bound."""


class _Declared(_Reader):
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
                    raise _Wrong("P101", "expected names, `-`, and a type", item)
                yield from ((word, type_) for word in waiting)
                waiting = []
            elif isinstance(item, Word) and item.kind == kind:
                waiting.append(item)
            else:
                what = "a variable" if kind == "VARIABLE" else "a name"
                raise _Wrong("P101", f"expected {what}, found {_shown(item)}", item)
        yield from ((word, None) for word in waiting)

    def type_of(self, node: Node | None) -> tuple[str, ...]:
        """The types that a type stands for: itself, or those of an `either`."""
        if node is None:
            return (OBJECT,)
        if isinstance(node, List):
            if node.head != "either" or len(node.items) < 2:
                raise _Wrong("P101", f"expected a type, found {_shown(node)}", node)
            found = (self._type(_name(each, "a type")) for each in node.items[1:])
            return tuple(dict.fromkeys(found))
        return (self._type(_name(node, "a type")),)

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
        for word, type_ in self.typed(_list(node, "`(?x - TYPE ...)`").items, "VARIABLE"):
            name = word.text[1:]
            if name in names:
                raise _Wrong("P202", f"variable `{word.text}` is declared twice", word)
            names.add(name)
            inner[name] = self.type_of(type_)
            found.append(TypedVariable(name, inner[name]))
        return tuple(found), inner

    def add_objects(self, section: List) -> Iterator[Object]:
        """The objects that a section declares."""
        for word, node in self.typed(section.items[1:], "NAME"):
            types = self.type_of(node)
            if len(types) > 1:
                raise _Wrong("P301", f"object `{word.text}` of several types (`either`)", word)
            if self.objects.get(word.text, types[0]) != types[0]:
                raise _Wrong("P202", f"object `{word.text}` is declared twice", word)
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
        word = _name(node, "an object or a variable")
        if word.text not in self.objects:
            raise self.unknown("object", word, self.objects)
        return Constant(word.text), (self.objects[word.text],)

    def atom(self, node: Node, scope: Scope) -> Atom:
        """An atom; one without arguments may lack its parentheses."""
        items = node.items if isinstance(node, List) else (node,)
        if not items:
            raise _Wrong("P101", "expected an atom, found `()`", node)
        word = _name(items[0], "a predicate")
        if word.text in _REFUSED:
            raise _refused(word.text, word)
        if word.text not in self.predicates:
            raise self.unknown("predicate", word, self.predicates)
        asked = self.predicates[word.text]
        if len(asked) != len(items) - 1:
            raise _Wrong(
                "P203",
                f"predicate `{word.text}` takes {len(asked)} arguments, not {len(items) - 1}",
                node,
            )
        terms = []
        for each, types in zip(items[1:], asked, strict=True):
            term, given = self.term(each, scope)
            if not self.fits(given, types):
                raise _Wrong(
                    "P204", f"{_shown(each)} is of type {' or '.join(given)}; `{word.text}` takes"
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
                _count(node, 1, "(not FORMULA)")
                return Not(self.formula(node.items[1], scope))
            case "imply":
                _count(node, 2, "(imply FORMULA FORMULA)")
                return Implies(
                    self.formula(node.items[1], scope), self.formula(node.items[2], scope)
                )
            case "exists" | "forall":
                _count(node, 2, f"({node.head} (VARIABLES) FORMULA)")
                variables, inner = self.variables(node.items[1], scope)
                body = self.formula(node.items[2], inner)
                return Exists(variables, body) if node.head == "exists" else ForAll(variables, body)
            case "=":
                _count(node, 2, "(= TERM TERM)")
                for each in node.items[1:]:
                    number = isinstance(each, List) or (
                        isinstance(each, Word) and each.kind == "NUMBER"
                    )
                    if number or (isinstance(each, Word) and each.text in self.functions):
                        raise _Wrong("P301", f"not read: {_NUMERIC}", node)
                left, right = (self.term(each, scope)[0] for each in node.items[1:])
                return Equality(left, right)
            case "<" | "<=" | ">" | ">=":
                raise _Wrong("P301", f"not read: {_NUMERIC}", node)
        return self.atom(node, scope)

    # --------------------------------------------------------------------------------------- numbers

    def number(self, node: Node) -> Fraction:
        """A number, or what is computed of numbers."""
        if isinstance(node, Word) and node.kind == "NUMBER":
            try:
                return Fraction(node.text if node.text[0] not in "./" else f"0{node.text}")
            except (ValueError, ZeroDivisionError):
                raise _Wrong("P205", f"`{node.text}` is no number", node) from None
        if (
            isinstance(node, List)
            and node.head in ("+", "-", "*", "/")
            and len(node.items) in (2, 3)
        ):
            values = [self.number(each) for each in node.items[1:]]
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
            raise _Wrong("P205", "this has no value", node)
        if isinstance(node, List) and node.head in self.functions:
            raise _Wrong("P301", "not read: amounts that depend on numeric fluents", node)
        raise _Wrong("P101", f"expected a number, found {_shown(node)}", node)

    def fluent(self, node: Node) -> str:
        """The name of a numeric fluent without arguments."""
        items = node.items if isinstance(node, List) else (node,)
        if not items:
            raise _Wrong("P101", "expected a numeric fluent, found `()`", node)
        word = _name(items[0], "a numeric fluent")
        if word.text not in self.functions:
            raise self.unknown("function", word, self.functions)
        if len(items) > 1 or self.functions[word.text]:
            raise _Wrong("P301", "not read: numeric fluents with arguments", node)
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
                _count(node, 1, "(not ATOM)")
                return Literal(self.atom(node.items[1], scope), positive=False)
            case "when":
                _count(node, 2, "(when FORMULA EFFECT)")
                condition = self.formula(node.items[1], scope)
                return When(condition, self.effect(node.items[2], scope))
            case "forall":
                _count(node, 2, "(forall (VARIABLES) EFFECT)")
                variables, inner = self.variables(node.items[1], scope)
                return Every(variables, self.effect(node.items[2], inner))
            case "probabilistic":
                return self._chance(node, scope)
            case "increase" | "decrease":
                _count(node, 2, f"({node.head} FLUENT NUMBER)")
                amount = self.number(node.items[2])
                return Pay(
                    self.fluent(node.items[1]), amount if node.head == "increase" else -amount
                )
        if node.head in _REFUSED:
            raise _refused(node.head, node)
        return Literal(self.atom(node, scope))

    def _chance(self, node: List, scope: Scope) -> Chance:
        rest = node.items[1:]
        if not rest or len(rest) % 2:
            raise _Wrong("P103", "expected `(probabilistic NUMBER EFFECT NUMBER EFFECT ...)`", node)
        choices = []
        for number, effect in zip(rest[::2], rest[1::2], strict=True):
            chance = self.number(number)
            if not 0 <= chance <= 1:
                raise _Wrong(
                    "P206", f"the probability {float(chance):g} is not between 0 and 1", number
                )
            choices.append((chance, self.effect(effect, scope)))
        total = sum(chance for chance, _ in choices)
        # Probabilities that were rounded may add up to a little more than 1.
        if total > 1 + _TOLERANCE:
            raise _Wrong("P206", f"the probabilities add up to {float(total):.9g}", node)
        if total > 1:
            choices = [(chance / total, effect) for chance, effect in choices]
        return Chance(tuple(choices))


def _refused(word: str, node: Node) -> _Wrong:
    return _Wrong("P301", f"not read: {_REFUSED[word]}", node)


class _DomainReader(_Declared):
    def __init__(self, definition: _Definition, diagnostics: list[Diagnostic]) -> None:
        super().__init__(definition.source, diagnostics)
        self.definition = definition
        self.name = definition.name.text

    def domain(self) -> PddlDomain:
        """The domain; what is wrong with it is among the diagnostics."""
        sections: dict[str, List] = {}
        actions: list[List] = []
        for node in self.definition.sections:
            with self.part():
                section = _list(node, "`(:KEYWORD ...)`")
                if section.head == ":action":
                    actions.append(section)
                elif section.head in _REFUSED:
                    raise _refused(section.head, section)
                elif section.head not in _DOMAIN_SECTIONS:
                    raise _Wrong("P101", f"{_shown(section)} is no part of a domain", section)
                elif section.head in sections:
                    raise _Wrong("P202", f"a second `{section.head}`", section)
                else:
                    sections[section.head] = section
        empty = List((), 0, 0, 1)
        with self.part():
            self._requirements(sections.get(":requirements", empty))
        with self.part():
            self._types(sections.get(":types", empty))
        constants: tuple[Object, ...] = ()
        with self.part():
            constants = tuple(self.add_objects(sections.get(":constants", empty)))
        for node in sections.get(":predicates", empty).items[1:]:
            with self.part():
                self._predicate(_list(node, "`(NAME ?x - TYPE ...)`"))
        with self.part():
            self._functions(sections.get(":functions", empty))
        made: list[Action] = []
        for node in actions:
            with self.part():
                made.append(self._action(node, {each.name for each in made}))
        return PddlDomain(
            self.name, tuple(Type(name, parent) for name, parent in self.types.items()), constants,
            tuple(Predicate(name, types) for name, types in self.predicates.items()),
            tuple(name for name, arity in self.functions.items() if not arity),
            tuple(made), self.span(self.definition.whole),
        )  # fmt: skip

    def _requirements(self, section: List) -> None:
        for each in section.items[1:]:
            if not isinstance(each, Word) or each.kind != "KEYWORD":
                raise _Wrong("P101", f"expected a requirement, found {_shown(each)}", each)
            if each.text in (":rewards", ":mdp"):
                self.functions[REWARD] = 0
            if each.text not in _REQUIREMENTS:
                self.warning("P501", f"the requirement `{each.text}` is not known", each)

    def _types(self, section: List) -> None:
        declared = list(self.typed(section.items[1:], "NAME"))
        places = {word.text: word for word, _ in declared}
        for word, node in declared:
            parent = OBJECT
            if isinstance(node, List):
                raise _Wrong("P301", "not read: a type below several others (`either`)", node)
            if node is not None:
                parent = _name(node, "a type").text
            if word.text == OBJECT:
                continue
            if self.types.get(word.text, parent) not in (parent, OBJECT):
                raise _Wrong("P202", f"type `{word.text}` is declared twice", word)
            if parent != OBJECT or word.text not in self.types:
                self.types[word.text] = parent
            if parent != OBJECT:
                # A type that is only named as a parent is below `object`.
                self.types.setdefault(parent, OBJECT)
        for name in self.types:
            seen = {name}
            above = self.types[name]
            while above != OBJECT:
                if above in seen:
                    place = places.get(name, section)
                    raise _Wrong("P207", f"type `{name}` is above itself", place)
                seen.add(above)
                above = self.types[above]

    def _predicate(self, node: List) -> None:
        if not node.items:
            raise _Wrong("P101", "expected a predicate, found `()`", node)
        word = _name(node.items[0], "a predicate")
        if word.text in self.predicates:
            raise _Wrong("P202", f"predicate `{word.text}` is declared twice", word)
        types = (self.type_of(type_) for _, type_ in self.typed(node.items[1:], "VARIABLE"))
        self.predicates[word.text] = tuple(types)

    def _functions(self, section: List) -> None:
        rest = iter(section.items[1:])
        for node in rest:
            if isinstance(node, Word) and node.text == "-":
                next(rest, None)  # `- number`, all that there is
                continue
            declared = _list(node, "`(NAME ?x - TYPE ...)`")
            if not declared.items:
                raise _Wrong("P101", "expected a function, found `()`", node)
            word = _name(declared.items[0], "a function")
            self.functions[word.text] = len(list(self.typed(declared.items[1:], "VARIABLE")))

    def _action(self, section: List, known: Collection[str]) -> Action:
        if len(section.items) < 2:
            raise _Wrong("P103", "expected `(:action NAME ...)`", section)
        word = _name(section.items[1])
        if word.text in known:
            raise _Wrong("P202", f"action `{word.text}` is declared twice", word)
        parts: dict[str, Node] = {}
        rest = iter(section.items[2:])
        for key in rest:
            value = next(rest, None)
            if not isinstance(key, Word) or key.text not in _ACTION_PARTS or value is None:
                wanted = ", ".join(f"`{each}`" for each in _ACTION_PARTS)
                raise _Wrong("P101", f"expected one of {wanted}, found {_shown(key)}", key)
            if key.text in parts:
                raise _Wrong("P202", f"a second `{key.text}`", key)
            parts[key.text] = value
        empty = List((), 0, 0, 1)
        parameters, scope = self.variables(parts.get(":parameters", empty), {})
        return Action(
            word.text, parameters, self.formula(parts.get(":precondition", empty), scope),
            self.effect(parts.get(":effect", empty), scope), self.span(section),
        )  # fmt: skip


class _ProblemReader(_Declared):
    def __init__(
        self, definition: _Definition, domain: _DomainReader, diagnostics: list[Diagnostic]
    ) -> None:
        super().__init__(definition.source, diagnostics)
        self.definition = definition
        self.domain = domain
        self.types, self.predicates = domain.types, domain.predicates
        self.functions = domain.functions
        self.objects = dict(domain.objects)

    def problem(self) -> PddlProblem:
        """The problem; what is wrong with it is among the diagnostics."""
        sections: dict[str, List] = {}
        for node in self.definition.sections:
            with self.part():
                section = _list(node, "`(:KEYWORD ...)`")
                if section.head not in _PROBLEM_SECTIONS:
                    raise _Wrong("P101", f"{_shown(section)} is no part of a problem", section)
                if section.head in sections:
                    raise _Wrong("P202", f"a second `{section.head}`", section)
                sections[section.head] = section
        empty = List((), 0, 0, 1)
        with self.part():
            self._domain_name(sections.get(":domain"))
        with self.part():
            self.domain._requirements(sections.get(":requirements", empty))
        objects: tuple[Object, ...] = ()
        with self.part():
            objects = tuple(self.add_objects(sections.get(":objects", empty)))
        init: dict[GroundAtom, None] = {}
        for node in sections.get(":init", empty).items[1:]:
            with self.part():
                atom = self._init(node)
                if atom is not None:
                    init[atom] = None
        goal = None
        reward = Fraction(0)
        with self.part():
            if ":goal" in sections:
                _count(sections[":goal"], 1, "(:goal FORMULA)")
                goal = self.formula(sections[":goal"].items[1], {})
        with self.part():
            if ":goal-reward" in sections:
                _count(sections[":goal-reward"], 1, "(:goal-reward NUMBER)")
                reward = self.number(sections[":goal-reward"].items[1])
        metric, sign = (REWARD, 1) if REWARD in self.functions else (ACHIEVED, 1)
        with self.part():
            if ":metric" in sections:
                metric, sign = self._metric(sections[":metric"])
        return PddlProblem(
            self.definition.name.text, objects, tuple(init), goal, reward, metric, sign,
            self.span(self.definition.whole),
        )  # fmt: skip

    def _domain_name(self, section: List | None) -> None:
        if section is None:
            raise _Wrong("P103", "the problem lacks `(:domain NAME)`", self.definition.whole)
        _count(section, 1, "(:domain NAME)")
        word = _name(section.items[1])
        if word.text != self.domain.name:
            raise _Wrong(
                "P208",
                f"the problem is for `{word.text}`, and the domain is `{self.domain.name}`",
                word,
            )

    def _init(self, node: Node) -> GroundAtom | None:
        if isinstance(node, List) and node.head == "=":
            _count(node, 2, "(= FLUENT NUMBER)")
            self.number(node.items[2])
            return None  # where a fluent begins makes no difference to what is paid
        if isinstance(node, List) and node.head == "probabilistic":
            raise _Wrong("P301", "not read: a probabilistic initial state", node)
        if isinstance(node, List) and node.head == "not":
            _count(node, 1, "(not ATOM)")
            self.atom(node.items[1], {})
            return None  # what is not listed does not hold
        found = self.atom(node, {})
        return GroundAtom(found.predicate, tuple(term.name for term in found.arguments))

    def _metric(self, section: List) -> tuple[str, int]:
        _count(section, 2, "(:metric maximize FLUENT)")
        way = _name(section.items[1], "`maximize` or `minimize`")
        if way.text not in ("maximize", "minimize"):
            raise _Wrong("P101", f"expected `maximize` or `minimize`, found `{way.text}`", way)
        sign = 1 if way.text == "maximize" else -1
        node = section.items[2]
        if isinstance(node, List) and node.head == "-" and len(node.items) == 2:
            sign, node = -sign, node.items[1]
        items = node.items if isinstance(node, List) else (node,)
        first = items[0] if items else None
        if isinstance(first, Word) and len(items) == 1 and first.text in (STEPS, ACHIEVED):
            return first.text, sign
        if isinstance(first, Word) and first.kind == "SIGN":
            raise _Wrong("P301", "not read: a metric that is computed of several fluents", node)
        return self.fluent(node), sign


_DOMAIN_SECTIONS = (":requirements", ":types", ":constants", ":predicates", ":functions")
_PROBLEM_SECTIONS = (
    ":domain", ":requirements", ":objects", ":init", ":goal", ":goal-reward", ":metric",
)  # fmt: skip
_ACTION_PARTS = (":parameters", ":precondition", ":effect")
# How much more than 1 probabilities may add up to.
_TOLERANCE = Fraction(1, 10**6)
