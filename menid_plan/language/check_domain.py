"""Checks a domain: its declarations; its rules are in `check_rules`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from menid_plan.language import syntax
from menid_plan.language.check_rules import RuleChecker
from menid_plan.language.declarations import Declarations, Documentation, param_values_of
from menid_plan.language.names import Names
from menid_plan.language.report import Report
from menid_plan.language.syntax import Token
from menid_plan.model.domain import (
    OBJECT,
    DerivedPredicate,
    Domain,
    Environment,
    Object,
    Param,
    Predicate,
    StateReward,
    Type,
)
from menid_plan.model.expressions import Expression
from menid_plan.model.rules import Action
from menid_plan.model.strata import NegativeCycle, negative_cycles
from menid_plan.source import Span


class DomainChecker(RuleChecker, Declarations):
    """Checks a domain. Names are gathered first, so that forward references are fine."""

    def __init__(self, report: Report, docs: Documentation) -> None:
        super().__init__(report, Names(), docs)
        self.first_objects = {}

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
        if nodes and target is None and not self.report.knows_errors:
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
        self.names.params.update(param_values_of(self.report, expressions))
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
