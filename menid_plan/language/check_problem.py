"""Checks a problem against the names of its domain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from menid_plan.language import syntax
from menid_plan.language.check_formulas import FormulaChecker
from menid_plan.language.declarations import Declarations, Documentation, param_values_of
from menid_plan.language.names import Names, Types
from menid_plan.language.report import Report
from menid_plan.language.syntax import Token
from menid_plan.model.domain import (
    Domain,
    Param,
    Problem,
)
from menid_plan.model.expressions import Expression, params_in
from menid_plan.model.formulas import Formula, GroundAtom
from menid_plan.model.probabilities import column_faults
from menid_plan.source import Span


class ProblemChecker(FormulaChecker, Declarations):
    """Checks a problem against the names of its domain."""

    def __init__(
        self, report: Report, names: Names, docs: Documentation, *, domain_is_sound: bool
    ) -> None:
        super().__init__(report, names)
        self._domain_is_sound = domain_is_sound
        self.doc: Callable[[Token], str] = docs
        self.first_objects = {}

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
            self.names.params.update(param_values_of(self.report, expressions))
            new = self.report.diagnostics[before:]
            if self._domain_is_sound and not any(d.is_error for d in new):
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
                atoms[GroundAtom(checked.predicate, tuple(t.name for t in checked.arguments))] = (
                    None
                )
        return tuple(atoms)

    def _discount(self, token: Token) -> float:
        value = float(token.value)
        if value > 1:
            self.report.error(
                "M431", f"a discount is between 0 and 1, not {token.value}", token,
                "it says how much a step later is worth: 0.99 is common, 1 is none",
            )  # fmt: skip
        return value

    def _values_of_blocks(self, domain: Domain, place: Token) -> None:
        """Warns of blocks for objects that this problem lacks: they are kept, and not used."""
        if self.report.knows_errors:
            return
        unused: dict[tuple[str, str], list[tuple[str, Span | None]]] = {}
        used: set[str] = set()
        seen: set[str] = set()
        for action in domain.actions:
            types = {v.name: v.types for v in action.parameters}
            for rule in action.rules:
                for block in (*rule.probabilities, *rule.observed):
                    for parameter, value in zip(rule.per, block.values, strict=False):
                        if self._fits(value, types.get(parameter, ())):
                            used.add(value)
                        elif value not in seen:
                            seen.add(value)
                            given = self.names.objects.get(value, "")
                            key = (f"{action.name}.{rule.name}", given)
                            unused.setdefault(key, []).append((value, block.span))
        for (rule_name, given), values in unused.items():
            self._unused(rule_name, given, values, used, place)

    def _fits(self, value: str, types: Types) -> bool:
        given = self.names.objects.get(value)
        return given is not None and self.names.fits((given,), types)

    def _unused(
        self, rule: str, given: str, values: list[tuple[str, Span | None]], used: set[str],
        place: Token,
    ) -> None:  # fmt: skip
        """One warning for all such blocks of a rule, where the first of them stands."""
        names = [name for name, _ in values]
        listed = ", ".join(f"`{name}`" for name in names[:3])
        if len(names) == 1:
            what = f"a `{given}` here" if given else "no object of this problem"
            message = f"rule {rule} has a block for {listed}, which is {what}"
            hint = "the block is kept, and not used"
        else:
            listed += f" and {len(names) - 3} more" if len(names) > 3 else ""
            what = f"of the type `{given}` here" if given else "no objects of this problem"
            message = f"rule {rule} has blocks for {listed}, which are {what}"
            hint = "the blocks are kept, and not used"
        # What is like an object with blocks of its own is no slip of the pen.
        others = [name for name in self.names.objects if name not in used]
        close = self.report.similar(names[0], others) if len(names) == 1 and not given else None
        self.report.warning(
            "M502", message, values[0][1] or place, f"did you mean `{close}`?" if close else hint
        )
