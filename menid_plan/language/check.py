"""From a syntax tree to a Domain and a Problem, with everything that is wrong with them.

Every declaration is looked at whatever is wrong with the others; a value is given only if nothing is.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any

from menid_plan.language import syntax
from menid_plan.language.check_formulas import FormulaChecker
from menid_plan.language.check_rules import RuleChecker
from menid_plan.language.names import Names, names_of
from menid_plan.language.parse import SyntaxResult, parse
from menid_plan.language.report import Report
from menid_plan.language.syntax import Token
from menid_plan.language.tokens import Comment
from menid_plan.model.domain import (
    OBJECT,
    DerivedPredicate,
    Domain,
    Environment,
    Object,
    Param,
    Predicate,
    Problem,
    StateReward,
    Type,
    param_values,
)
from menid_plan.model.expressions import EvaluationError, Expression, evaluate, params_in
from menid_plan.model.formulas import Formula, GroundAtom
from menid_plan.model.probabilities import column_faults
from menid_plan.model.rules import Action
from menid_plan.model.strata import NegativeCycle, negative_cycles
from menid_plan.source import Diagnostic, SourceFile, Span, in_order

# A range of objects may name this many.
MAX_RANGE = 100_000


@dataclass(frozen=True, slots=True)
class Known:
    """A domain to check problems against, as far as it is without errors.

    ``lost_names`` are names that its text may declare in parts that could not be read.
    """

    domain: Domain
    names: Names
    lost_names: frozenset[str] = frozenset()

    @staticmethod
    def of(domain: Domain) -> Known:
        """A domain that is without errors."""
        return Known(domain, names_of(domain, param_values(domain)))


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What a text holds. ``domain`` and ``problem`` are None if absent or with errors.

    ``known`` is the text's domain as far as it could be understood, errors or not.
    """

    domain: Domain | None
    problem: Problem | None
    diagnostics: tuple[Diagnostic, ...]
    known: Known | None = None

    @property
    def has_errors(self) -> bool:
        """Whether any diagnostic is an error."""
        return any(d.is_error for d in self.diagnostics)


def check(source: SourceFile, known: Known | None = None) -> CheckResult:
    """Parse and check a text; ``known`` is the domain of a problem that stands alone in its text."""
    return check_syntax(parse(source), known)


def check_syntax(result: SyntaxResult, known: Known | None = None) -> CheckResult:
    """Check a parsed text; see `check`."""
    lost = result.lost_names | (known.lost_names if known else set())
    report = Report(result.stream.source, lost)
    _reserved_names(result, report)
    docs = Documentation(result.stream.comments, result.stream.source)
    tree = result.file
    if tree.domain is None and tree.problem is None and not result.diagnostics:
        report.warning("M104", "the text holds neither a domain nor a problem", report.start)
    domain: Domain | None = None
    problem: Problem | None = None
    if tree.domain is not None:
        checker = DomainChecker(report, docs)
        domain = checker.domain(tree.domain)
        known = Known(domain, checker.names, frozenset(result.lost_names))
    if tree.problem is not None and known is not None:
        names = known.names.for_problem()
        problem = ProblemChecker(report, names, docs).problem(tree.problem, known.domain)
    diagnostics = tuple(in_order([*result.diagnostics, *report.diagnostics]))
    own = known if tree.domain is not None else None
    if any(d.is_error for d in diagnostics):
        return CheckResult(None, None, diagnostics, own)
    return CheckResult(domain, problem, diagnostics, own)


def _reserved_names(result: SyntaxResult, report: Report) -> None:
    """A reserved word before a colon lexes as a name; report those that parsed as one."""
    from menid_plan.language.grammar import lexer

    known = {d.span.start for d in result.diagnostics}
    for token in result.stream.tokens:
        if token.type == "NAME_COLON" and token.value in lexer().reserved_words:
            if token.start not in known:
                message = f"`{token.value}` is a reserved word and can't be a name"
                report.error("M102", message, token)


class Documentation:
    """The comment lines that stand directly above a token."""

    def __init__(self, comments: Iterable[Comment], source: SourceFile) -> None:
        self._source = source
        self._before: dict[int, list[Comment]] = {}
        for comment in comments:
            if comment.own_line:
                self._before.setdefault(comment.before, []).append(comment)

    def __call__(self, token: Token) -> str:
        line = self._source.position(token.start)[0]
        lines: list[str] = []
        for comment in reversed(self._before.get(token.index, ())):
            if self._source.position(comment.start)[0] != line - 1:
                break
            text = comment.text[1:]
            lines.append(text[1:] if text.startswith(" ") else text)
            line -= 1
        return "\n".join(reversed(lines))


class _Declarations:
    """What a domain and a problem declare alike: params and groups of objects."""

    report: Report
    names: Names
    doc: Callable[[Token], str]

    def objects(self, node: syntax.Constants | syntax.Objects, type_: str) -> list[Object]:
        attributes: dict[str, float] = {}
        for attribute in node.attributes:
            if attribute.name.value in attributes:
                self.report.duplicate("attribute", attribute.name, None)
            value = float(attribute.number.value)
            attributes[attribute.name.value] = -value if attribute.sign else value
        given = tuple(attributes.items())
        doc = self.doc(node.keyword)
        objects = []
        for item in node.names:
            span = self.report.span(item)
            token = item.last if isinstance(item, syntax.ObjectRange) else item
            for name in self._expand(item):
                if name in self.names.objects:
                    self.report.duplicate("object", _renamed(token, name), None)
                self.names.objects[name] = type_
                objects.append(Object(name, type_, given, doc, span))
        return objects

    def _expand(self, item: Token | syntax.ObjectRange) -> list[str]:
        if isinstance(item, Token):
            return [item.value]
        first, last = _numbered(item.first.value), _numbered(item.last.value)
        if first is None or last is None or first[0] != last[0]:
            self.report.error(
                "M305", "a range runs between two names that differ in a last whole number", item,
                "for example n1..n20; no leading zeros",
            )  # fmt: skip
            return []
        if last[1] < first[1]:
            self.report.error("M305", "a range ascends", item)
            return []
        if last[1] - first[1] >= MAX_RANGE:
            self.report.error("M305", f"a range names at most {MAX_RANGE} objects", item)
            return []
        return [f"{first[0]}{number}" for number in range(first[1], last[1] + 1)]


_NUMBERED = re.compile(r"(.*?)(0|[1-9][0-9]{0,17})", re.ASCII)


def _numbered(name: str) -> tuple[str, int] | None:
    """A name's prefix and number; None if it ends in no number without leading zeros."""
    match = _NUMBERED.fullmatch(name)
    return (match[1], int(match[2])) if match and not match[1][-1:].isdigit() else None


def _renamed(token: Token, name: str) -> Token:
    return Token(token.type, name, token.start, token.end, token.index)


def _values(
    report: Report, expressions: dict[str, tuple[Expression, Any]]
) -> dict[str, float | None]:
    """The value of each param; None, and a report, for one that has none."""
    values: dict[str, float | None] = {}
    graph = {
        name: {p for p in params_in(expression) if p in expressions}
        for name, (expression, _) in expressions.items()
    }
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        cycle = list(reversed(error.args[1]))
        text = " -> ".join(cycle)
        report.error("M414", f"params depend on each other: {text}", expressions[cycle[0]][1])
        return dict.fromkeys(expressions)
    for name in order:
        expression, node = expressions[name]
        known = {p: values.get(p) for p in params_in(expression)}
        values[name] = None
        if all(value is not None for value in known.values()):
            try:
                values[name] = evaluate(expression, {p: v for p, v in known.items() if v is not None})
            except EvaluationError as error:
                report.error("M413", f"this expression has no value: {error}", node)
    return values


class DomainChecker(RuleChecker, _Declarations):
    """Checks a domain. Names are gathered first, so that forward references are fine."""

    def __init__(self, report: Report, docs: Documentation) -> None:
        super().__init__(report, Names(), docs)

    def domain(self, node: syntax.Domain) -> Domain:
        """The domain of a tree; worth something only if nothing was reported."""
        items = node.items
        types = self._types([i for i in items if isinstance(i, syntax.Types)])
        environments = self._roles([i for i in items if isinstance(i, syntax.Environment)])
        constants = self._constants([i for i in items if isinstance(i, syntax.Constants)])
        predicates = self._signatures(items)
        params = self._params([i for i in items if isinstance(i, syntax.Param)])
        derived = self._derived([i for i in items if isinstance(i, syntax.Derived)])
        rewards = [self._reward(i) for i in items if isinstance(i, syntax.StateReward)]
        seen: dict[str, Token] = {}
        actions: list[Action] = []
        for item in items:
            if isinstance(item, syntax.Action):
                self._once("action", item.name, seen)
                actions.append(self.action(item))
        domain = Domain(
            node.name.value, tuple(types), tuple(constants), tuple(params), tuple(environments),
            tuple(predicates), tuple(derived), tuple(rewards), tuple(actions),
            self.doc(node.keyword), self.report.span(node.keyword, node.name),
        )  # fmt: skip
        for violation in negative_cycles(domain):
            self._unstratified(violation, violation.culprit.span)
        return domain

    # ---------------------------------------------------------------------------------- types

    def _types(self, nodes: Sequence[syntax.Types]) -> list[Type]:
        seen: dict[str, Token] = {}
        parents = self.names.parents
        types = []
        for node in nodes:
            parent = node.parent.value if node.parent else OBJECT
            for token in node.names:
                if self._once("type", token, seen):
                    parents[token.value] = parent
                span = self.report.span(token)
                types.append(Type(token.value, parent, self.doc(node.keyword), span))
        for node in nodes:
            if node.parent:
                self.type(node.parent)
        self._type_cycles(seen)
        return types

    def _type_cycles(self, tokens: dict[str, Token]) -> None:
        parents = self.names.parents
        settled: set[str] = {OBJECT}
        for start in parents:
            path: dict[str, None] = {}
            name = start
            while name not in settled and name not in path and name in parents:
                path[name] = None
                name = parents[name]
            if name in path and name not in settled:
                cycle = list(path)[list(path).index(name) :]
                text = " < ".join([*cycle, name])
                self.report.error("M301", f"types descend from each other: {text}", tokens[name])
            settled.update(path)

    # ----------------------------------------------------------------------------- environments

    def _roles(self, nodes: Sequence[syntax.Environment]) -> list[Environment]:
        seen: dict[str, Token] = {}
        environments: list[Environment] = []
        target: Token | None = None
        for node in nodes:
            self._once("environment", node.name, seen)
            role = node.role.value
            if role not in ("target", "test"):
                self.report.error(
                    "M308", f"`{role}` is no role of an environment", node.role,
                    "write `target` for the place that counts, `test` for one to try things in",
                )  # fmt: skip
                role = "test"
                target = target or node.name  # perhaps the target was meant
            elif role == "target":
                if target is not None and environments:
                    self.report.error(
                        "M306", "a second target", node.name,
                        f"`{target.value}` is the target; the others are `test`",
                    )  # fmt: skip
                target = node.name
            environments.append(
                Environment(
                    node.name.value, "target" if role == "target" else "test",
                    self.doc(node.keyword), self.report.span(node.keyword, node.name),
                )
            )  # fmt: skip
        if nodes and target is None:
            self.report.error(
                "M307", "no environment is the target", nodes[0].name,
                f"write `environment {nodes[0].name.value} : target` for the one that counts",
            )  # fmt: skip
        self.names.environments = tuple(seen) or ("target",)
        return environments

    # ------------------------------------------------------------- constants, params, predicates

    def _constants(self, nodes: Sequence[syntax.Constants]) -> list[Object]:
        constants = []
        for node in nodes:
            constants.extend(self.objects(node, self.type(node.type)))
        self.names.constants = frozenset(self.names.objects)
        return constants

    def _signatures(self, items: Sequence[syntax.DomainItem]) -> list[Predicate]:
        """Declares predicates, derived predicates and params, which share their names."""
        seen: dict[str, Token] = {}
        predicates = []
        for item in items:
            match item:
                case syntax.Predicate(keyword, name, arguments):
                    if self._once("predicate", name, seen):
                        types = tuple(self.types(union) for union in arguments)
                        self.names.predicates[name.value] = types
                        span = self.report.span(keyword, name)
                        predicates.append(Predicate(name.value, types, self.doc(keyword), span))
                case syntax.Derived(_, name, parameters):
                    if self._once("predicate", name, seen):
                        self.names.derived[name.value] = tuple(
                            tuple(token.value for token in group.types)
                            for group in parameters
                            for _ in group.names
                        )
                case syntax.Param(_, name):
                    if self._once("param", name, seen):
                        self.names.params[name.value] = None
        return predicates

    def _params(self, nodes: Sequence[syntax.Param]) -> list[Param]:
        expressions: dict[str, tuple[Expression, Any]] = {}
        params = []
        for node in nodes:
            value = self._expression(node.value)
            expressions.setdefault(node.name.value, (value, node.value))
            span = self.report.span(node.keyword, node.name)
            params.append(Param(node.name.value, value, self.doc(node.keyword), span))
        self.names.params.update(_values(self.report, expressions))
        return params

    # ------------------------------------------------------------------------- derived, rewards

    def _derived(self, nodes: Sequence[syntax.Derived]) -> list[DerivedPredicate]:
        derived = []
        for node in nodes:
            parameters, scope = self.variables(node.parameters, {})
            formula = self.formula(node.formula, scope)
            span = self.report.span(node.keyword, node.name)
            derived.append(
                DerivedPredicate(node.name.value, parameters, formula, self.doc(node.keyword), span)
            )
        return derived

    def _unstratified(self, violation: NegativeCycle, place: Span | None) -> None:
        culprit = violation.culprit.name
        cycle = [*(p.name for p in violation.predicates), culprit]
        text = " -> ".join(cycle if len(cycle) < 9 else [*cycle[:4], "...", *cycle[-4:]])
        self.report.error(
            "M420",
            f"`{culprit}` depends on itself through a negation: {text}",
            place,
            "a derived predicate may use itself only where it is not negated "
            "(`not`, the left of `implies`, and counts with `<`, `<=`, `=`, `!=` negate)",
        )

    def _reward(self, node: syntax.StateReward) -> StateReward:
        variables, scope = self.variables(node.variables, {})
        return StateReward(
            self.expression(node.reward), self.formula(node.condition, scope), variables,
            self.doc(node.keyword), self.report.span(node.keyword),
        )  # fmt: skip


class ProblemChecker(FormulaChecker, _Declarations):
    """Checks a problem against the names of its domain."""

    def __init__(self, report: Report, names: Names, docs: Documentation) -> None:
        super().__init__(report, names)
        self.doc: Callable[[Token], str] = docs

    def problem(self, node: syntax.Problem, domain: Domain) -> Problem:
        """The problem of a tree; worth something only if nothing was reported."""
        if node.domain.value != domain.name and node.domain.value and domain.name:
            self.report.error(
                "M212", f"the problem is for `{node.domain.value}`, the domain is `{domain.name}`",
                node.domain, f"write `for {domain.name}`, or give the other domain",
            )  # fmt: skip
        single: dict[str, Any] = {}
        for item in node.items:
            if isinstance(item, syntax.Goal | syntax.Horizon | syntax.Discount | syntax.DeadEnd):
                if item.keyword.value in single:
                    self.report.error(
                        "M432", f"a problem has at most one `{item.keyword.value}`", item.keyword
                    )
                single.setdefault(item.keyword.value, item)
        objects = [
            o
            for item in node.items
            if isinstance(item, syntax.Objects)
            for o in self.objects(item, self.type(item.type))
        ]
        params = self._params([i for i in node.items if isinstance(i, syntax.Param)], domain)
        init = self._init([i for i in node.items if isinstance(i, syntax.Init)])
        goal: syntax.Goal | None = single.get("goal")
        dead_end: syntax.DeadEnd | None = single.get("dead-end")
        formula: Formula | None = self.formula(goal.formula, {}) if goal else None
        self._values_of_blocks(domain, node.name)
        return Problem(
            node.name.value, node.domain.value, params, tuple(objects), init, formula,
            self.expression(goal.reward) if goal and goal.reward else None,
            self.whole_number(single["horizon"].number) if "horizon" in single else None,
            self._discount(single["discount"].number) if "discount" in single else None,
            self.expression(dead_end.reward) if dead_end else None,
            self.doc(node.keyword), self.report.span(node.keyword, node.name),
        )  # fmt: skip

    def _params(self, nodes: Sequence[syntax.Param], domain: Domain) -> tuple[Param, ...]:
        expressions: dict[str, tuple[Expression, Any]] = {
            p.name: (p.value, nodes[0].name) for p in domain.params if nodes
        }
        seen: dict[str, Token] = {}
        params = []
        for node in nodes:
            name = node.name
            if seen.setdefault(name.value, name) is not name:
                self.report.duplicate("param", name, seen[name.value])
            if name.value not in self.names.params:
                self.report.unknown(
                    "M205", "param", name, self.names.params,
                    None if self.names.params else "a problem sets params of its domain anew",
                )  # fmt: skip
            value = self._expression(node.value)
            expressions[name.value] = (value, node.value)
            span = self.report.span(node.keyword, name)
            params.append(Param(name.value, value, self.doc(node.keyword), span))
        if nodes:
            before = len(self.report.diagnostics)
            self.names.params.update(_values(self.report, expressions))
            if not any(d.is_error for d in self.report.diagnostics[before:]):
                self._columns_again(nodes, domain)
        return tuple(params)

    def _columns_again(self, nodes: Sequence[syntax.Param], domain: Domain) -> None:
        """Setting a param can spoil a column that summed to 1 before."""
        values = {name: v for name, v in self.names.params.items() if v is not None}
        if len(values) < len(self.names.params) or any(d.is_error for d in self.report.diagnostics):
            return
        for fault in column_faults(domain, values):
            used = {p for cell in fault.column.cells for p in params_in(cell)}
            node = next((n for n in nodes if n.name.value in used), nodes[0])
            self.report.error("M424", f"with the params of this problem, {fault}", node.name)

    def _init(self, nodes: Sequence[syntax.Init]) -> tuple[GroundAtom, ...]:
        atoms: dict[GroundAtom, None] = {}
        for node in nodes:
            for atom in node.atoms:
                checked = self.atom(atom, {}, basic_for="in `init`")
                atoms[GroundAtom(checked.predicate, tuple(t.name for t in checked.arguments))] = None
        return tuple(atoms)

    def _discount(self, token: Token) -> float:
        value = float(token.value)
        if value > 1:
            self.report.error("M431", f"a discount is between 0 and 1, not {token.value}", token)
        return value

    def _values_of_blocks(self, domain: Domain, place: Token) -> None:
        """Warns of blocks for objects that this problem lacks: they are kept, and not used."""
        missing: dict[str, str] = {}
        for action in domain.actions:
            for rule in action.rules:
                for block in (*rule.probabilities, *rule.observed):
                    for value in block.values:
                        if value not in self.names.objects:
                            missing.setdefault(value, f"{action.name}.{rule.name}")
        for value, rule_name in list(missing.items())[:5]:
            more = f", and {len(missing) - 5} more such" if len(missing) > 5 else ""
            self.report.warning(
                "M502", f"rule {rule_name} has a block for `{value}`, no object here{more}", place,
                "the block is kept, and not used in this problem",
            )  # fmt: skip
