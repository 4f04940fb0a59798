"""From texts to a PPDDL domain and problem, with all that is wrong with them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

from menid_plan.model.domain import OBJECT, Object, Predicate, Type
from menid_plan.model.formulas import GroundAtom
from menid_plan.ppddl.parts import (
    ACHIEVED,
    REFUSED,
    REWARD,
    STEPS,
    Declared,
    Enough,
    Reader,
    Wrong,
    demand,
    list_in,
    name_in,
    refused,
    shown,
)
from menid_plan.ppddl.syntax import List, Node, Word, parse
from menid_plan.ppddl.task import Action, PddlDomain, PddlProblem
from menid_plan.source import Diagnostic, SourceFile, Span, in_order

_REQUIREMENTS = frozenset(
    ":strips :typing :equality :negative-preconditions :disjunctive-preconditions"
    " :existential-preconditions :universal-preconditions :quantified-preconditions"
    " :conditional-effects :probabilistic-effects :rewards :mdp :adl :fluents".split()
)


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
    domain = read_problem = None
    with suppress(Enough):
        domain, read_problem = _read(sources, problem, diagnostics)
    if any(each.is_error for each in diagnostics):
        domain = read_problem = None
    return ReadResult(domain, read_problem, tuple(in_order(diagnostics)))


def _read(
    sources: Iterable[SourceFile], problem: str | None, diagnostics: list[Diagnostic]
) -> tuple[PddlDomain | None, PddlProblem | None]:
    found: dict[str, _Definition] = {}
    others: list[str] = []
    last: SourceFile | None = None
    for source in sources:
        lists, wrong = parse(source)
        diagnostics += wrong
        last = source
        reader = Reader(source, diagnostics)
        for each in lists:
            with reader.part():
                kind, definition = _define(source, each)
                if kind == "problem" and problem not in (None, definition.name.text):
                    others.append(definition.name.text)
                    continue
                if kind in found:
                    hint = "say which one is wanted by its name" if kind == "problem" else None
                    raise Wrong("P102", f"a second {kind}; one of each is read", each, hint)
                found[kind] = definition
    domain = None
    read_problem = None
    if "domain" in found:
        of_domain = _DomainReader(found["domain"], diagnostics)
        domain = of_domain.domain()
        if "problem" in found:
            read_problem = _ProblemReader(found["problem"], of_domain, diagnostics).problem()
    if last is not None and (found or not diagnostics):
        for kind in ("domain", "problem"):
            if kind not in found:
                message = f"there is no {kind}: expected `(define ({kind} NAME) ...)`"
                if kind == "problem" and others:
                    message = f"there is no problem `{problem}`; there are: {', '.join(others)}"
                hint = "it may be in a second file" if found else None
                span = Span(last, 0, min(1, len(last.text)))
                diagnostics.append(Diagnostic("error", "P101", message, span, hint))
    return domain, read_problem


def _define(source: SourceFile, each: List) -> tuple[str, _Definition]:
    items = each.items
    form = "`(define (domain NAME) ...)` or `(define (problem NAME) ...)`"
    if each.head != "define" or len(items) < 2 or not isinstance(items[1], List):
        raise Wrong("P101", f"expected {form}, found {shown(each)}", each)
    kind = items[1].head
    if kind not in ("domain", "problem") or len(items[1].items) != 2:
        raise Wrong("P101", f"expected {form}, found {shown(items[1])}", items[1])
    return kind, _Definition(source, name_in(items[1].items[1]), items[2:], each)


class _DomainReader(Declared):
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
                section = list_in(node, "`(:KEYWORD ...)`")
                if section.head == ":action":
                    actions.append(section)
                elif section.head in REFUSED:
                    raise refused(section.head, section)
                elif section.head not in _DOMAIN_SECTIONS:
                    raise Wrong("P101", f"{shown(section)} is no part of a domain", section)
                elif section.head in sections:
                    raise Wrong("P202", f"a second `{section.head}`", section)
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
                self._predicate(list_in(node, "`(NAME ?x - TYPE ...)`"))
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
                raise Wrong("P101", f"expected a requirement, found {shown(each)}", each)
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
                raise Wrong("P301", "not read: a type below several others (`either`)", node)
            if node is not None:
                parent = name_in(node, "a type").text
            if word.text == OBJECT:
                continue
            if self.types.get(word.text, parent) not in (parent, OBJECT):
                raise Wrong("P202", f"type `{word.text}` is declared twice", word)
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
                    raise Wrong("P207", f"type `{name}` is above itself", place)
                seen.add(above)
                above = self.types[above]

    def _predicate(self, node: List) -> None:
        if not node.items:
            raise Wrong("P101", "expected a predicate, found `()`", node)
        word = name_in(node.items[0], "a predicate")
        if word.text in self.predicates:
            raise Wrong("P202", f"predicate `{word.text}` is declared twice", word)
        types = (self.type_of(type_) for _, type_ in self.typed(node.items[1:], "VARIABLE"))
        self.predicates[word.text] = tuple(types)

    def _functions(self, section: List) -> None:
        rest = iter(section.items[1:])
        for node in rest:
            if isinstance(node, Word) and node.text == "-":
                next(rest, None)  # `- number`, all that there is
                continue
            declared = list_in(node, "`(NAME ?x - TYPE ...)`")
            if not declared.items:
                raise Wrong("P101", "expected a function, found `()`", node)
            word = name_in(declared.items[0], "a function")
            self.functions[word.text] = len(list(self.typed(declared.items[1:], "VARIABLE")))

    def _action(self, section: List, known: Collection[str]) -> Action:
        if len(section.items) < 2:
            raise Wrong("P103", "expected `(:action NAME ...)`", section)
        word = name_in(section.items[1])
        if word.text in known:
            raise Wrong("P202", f"action `{word.text}` is declared twice", word)
        parts: dict[str, Node] = {}
        rest = iter(section.items[2:])
        for key in rest:
            value = next(rest, None)
            if not isinstance(key, Word) or key.text not in _ACTION_PARTS or value is None:
                wanted = ", ".join(f"`{each}`" for each in _ACTION_PARTS)
                raise Wrong("P101", f"expected one of {wanted}, found {shown(key)}", key)
            if key.text in parts:
                raise Wrong("P202", f"a second `{key.text}`", key)
            parts[key.text] = value
        empty = List((), 0, 0, 1)
        parameters, scope = self.variables(parts.get(":parameters", empty), {})
        return Action(
            word.text, parameters, self.formula(parts.get(":precondition", empty), scope),
            self.effect(parts.get(":effect", empty), scope), self.span(section),
        )  # fmt: skip


class _ProblemReader(Declared):
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
                section = list_in(node, "`(:KEYWORD ...)`")
                if section.head not in _PROBLEM_SECTIONS:
                    raise Wrong("P101", f"{shown(section)} is no part of a problem", section)
                if section.head in sections:
                    raise Wrong("P202", f"a second `{section.head}`", section)
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
                demand(sections[":goal"], 1, "(:goal FORMULA)")
                goal = self.formula(sections[":goal"].items[1], {})
        with self.part():
            if ":goal-reward" in sections:
                demand(sections[":goal-reward"], 1, "(:goal-reward NUMBER)")
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
            raise Wrong("P103", "the problem lacks `(:domain NAME)`", self.definition.whole)
        demand(section, 1, "(:domain NAME)")
        word = name_in(section.items[1])
        if word.text != self.domain.name:
            raise Wrong(
                "P208",
                f"the problem is for `{word.text}`, and the domain is `{self.domain.name}`",
                word,
            )

    def _init(self, node: Node) -> GroundAtom | None:
        if isinstance(node, List) and node.head == "=":
            demand(node, 2, "(= FLUENT NUMBER)")
            self.number(node.items[2])
            return None  # where a fluent begins makes no difference to what is paid
        if isinstance(node, List) and node.head == "probabilistic":
            raise Wrong("P301", "not read: a probabilistic initial state", node)
        if isinstance(node, List) and node.head == "not":
            demand(node, 1, "(not ATOM)")
            self.atom(node.items[1], {})
            return None  # what is not listed does not hold
        found = self.atom(node, {})
        return GroundAtom(found.predicate, tuple(term.name for term in found.arguments))

    def _metric(self, section: List) -> tuple[str, int]:
        demand(section, 2, "(:metric maximize FLUENT)")
        way = name_in(section.items[1], "`maximize` or `minimize`")
        if way.text not in ("maximize", "minimize"):
            raise Wrong("P101", f"expected `maximize` or `minimize`, found `{way.text}`", way)
        sign = 1 if way.text == "maximize" else -1
        node = section.items[2]
        if isinstance(node, List) and node.head == "-" and len(node.items) == 2:
            sign, node = -sign, node.items[1]
        items = node.items if isinstance(node, List) else (node,)
        first = items[0] if items else None
        if isinstance(first, Word) and len(items) == 1 and first.text in (STEPS, ACHIEVED):
            return first.text, sign
        if isinstance(first, Word) and first.kind == "SIGN":
            raise Wrong("P301", "not read: a metric that is computed of several fluents", node)
        return self.fluent(node), sign


_DOMAIN_SECTIONS = (":requirements", ":types", ":constants", ":predicates", ":functions")
_PROBLEM_SECTIONS = (
    ":domain", ":requirements", ":objects", ":init", ":goal", ":goal-reward", ":metric",
)  # fmt: skip
_ACTION_PARTS = (":parameters", ":precondition", ":effect")
