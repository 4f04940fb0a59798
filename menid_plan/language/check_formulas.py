"""Checks formulas, variables and expressions, and gives their values in the model."""

from __future__ import annotations

import math
from typing import cast

from menid_plan.language import syntax
from menid_plan.language.names import UNKNOWN, Names, Scope, Types
from menid_plan.language.report import Report
from menid_plan.language.syntax import Token
from menid_plan.language.tokens import shown
from menid_plan.model import expressions as ex
from menid_plan.model import formulas as fo
from menid_plan.model.domain import OBJECT


class FormulaChecker:
    """Formulas and expressions of a text that declares ``names``.

    What is wrong goes to the report; a value comes back all the same, so that checking goes on.
    """

    def __init__(self, report: Report, names: Names) -> None:
        self.report = report
        self.names = names

    # ------------------------------------------------------------------------------- formulas

    def formula(self, node: syntax.Formula, scope: Scope) -> fo.Formula:
        """The formula that a node stands for, its variables looked up in ``scope``."""
        match node:
            case syntax.Atom():
                return self.atom(node, scope)
            case syntax.Negation(formula):
                return fo.Not(self.formula(formula, scope))
            case syntax.Conjunction(formulas):
                return fo.And(tuple(self.formula(f, scope) for f in formulas))
            case syntax.Disjunction(formulas):
                return fo.Or(tuple(self.formula(f, scope) for f in formulas))
            case syntax.Implication(left, right):
                return fo.Implies(self.formula(left, scope), self.formula(right, scope))
            case syntax.Exists(variables, formula):
                declared, inner = self.variables(variables, scope)
                return fo.Exists(declared, self.formula(formula, inner))
            case syntax.Forall(variables, formula):
                declared, inner = self.variables(variables, scope)
                return fo.ForAll(declared, self.formula(formula, inner))
            case syntax.Count(variables, formula, comparison, number):
                declared, inner = self.variables(variables, scope)
                body = self.formula(formula, inner)
                operator = cast("fo.Comparison", comparison.value)
                return fo.Count(declared, body, operator, self.whole_number(number))
            case syntax.Truth(token):
                return fo.Truth(token.value == "true")
            case syntax.Equality(left, right):
                return fo.Equality(self.term(left, scope)[0], self.term(right, scope)[0])
            case syntax.Inequality(left, right):
                return fo.Not(fo.Equality(self.term(left, scope)[0], self.term(right, scope)[0]))

    def atom(self, node: syntax.Atom, scope: Scope, basic_for: str = "") -> fo.Atom:
        """An atom, its arguments checked; ``basic_for`` names what a derived one can't be used in."""
        name = node.name.value
        asked = self.names.arguments(name)
        arguments = [self.term(argument, scope) for argument in node.arguments]
        atom = fo.Atom(name, tuple(term for term, _ in arguments))
        if asked is None:
            self._unknown_predicate(node)
        elif basic_for and name in self.names.derived:
            self.report.error(
                "M304",
                f"`{name}` is a derived predicate and can't be {basic_for}",
                node.name,
                "change the basic predicates that it is derived from",
            )
        elif len(asked) != len(arguments):
            expected = f"{len(asked)} argument{'' if len(asked) == 1 else 's'}"
            self.report.error(
                "M302", f"`{name}` takes {expected}, not {len(arguments)}", node,
                f"declared as {signature(name, asked)}",
            )  # fmt: skip
        else:
            for token, (_, given), wanted in zip(node.arguments, arguments, asked, strict=True):
                if given and not self.names.fits(given, wanted):
                    self.report.error(
                        "M303",
                        f"`{token.value}` is of type {_types(given)}, but `{name}` asks for "
                        f"{_types(wanted)}",
                        token,
                        f"declared as {signature(name, asked)}",
                    )
        return atom

    def _unknown_predicate(self, node: syntax.Atom) -> None:
        name = node.name.value
        hint = None
        if name in self.names.params:
            hint = f"`{name}` is a param, which has no place in a formula or effect"
        elif name in self.names.parents:
            hint = f"`{name}` is a type; say what holds with a predicate"
        candidates = [*self.names.predicates, *self.names.derived]
        self.report.unknown("M203", "predicate", node.name, candidates, hint)

    def term(self, token: Token, scope: Scope) -> tuple[fo.Term, Types]:
        """The variable, constant or object of that name and its types (empty if unknown)."""
        name = token.value
        types = scope.get(name)
        if types is not None:
            return fo.Variable(name), types
        type_ = self.names.objects.get(name)
        if type_ is not None:
            return fo.Constant(name), (type_,)
        hint = None
        if name in self.names.parents or name == OBJECT:
            hint = f"`{name}` is a type; an argument is a variable, a constant or an object"
        elif scope and not self.names.constants:
            hint = "a variable, or a constant of the domain; a rule can't name a problem's objects"
        kind = "object" if not scope else "variable or constant"
        self.report.unknown("M204", kind, token, [*scope, *self.names.objects], hint)
        return fo.Variable(name), ()

    # ------------------------------------------------------------------------------ variables

    def variables(
        self, groups: list[syntax.VariableGroup], scope: Scope
    ) -> tuple[tuple[fo.TypedVariable, ...], Scope]:
        """Declared variables, and the scope in which they can be used too."""
        declared: list[fo.TypedVariable] = []
        inner = dict(scope)
        for group in groups:
            types = self.types(group.types)
            for token in group.names:
                hides = self._hides(token, inner)
                inner[token.value] = (UNKNOWN,) if hides else types
                declared.append(fo.TypedVariable(token.value, types))
        return tuple(declared), inner

    def _hides(self, token: Token, scope: Scope) -> bool:
        name = token.value
        if name in scope:
            message = f"variable `{name}` hides another variable of that name"
        elif name in self.names.constants:
            message = f"variable `{name}` hides the constant of that name"
        else:
            return False
        self.report.error("M208", message, token, "give it a name of its own")
        return True

    def types(self, tokens: list[Token]) -> Types:
        """The types of a union, each declared."""
        return tuple(self.type(token) for token in tokens)

    def type(self, token: Token) -> str:
        """A declared type; UNKNOWN in place of one that is not."""
        name = token.value
        if name == OBJECT or name in self.names.parents:
            return name
        self.report.unknown("M202", "type", token, self.names.types)
        return UNKNOWN

    # ---------------------------------------------------------------------------- expressions

    def expression(self, node: syntax.Expression) -> ex.Expression:
        """An expression whose params are declared and whose value, if it can be had, is finite."""
        expression = self._expression(node)
        self.value(expression, node)
        return expression

    def _expression(self, node: syntax.Expression) -> ex.Expression:
        match node:
            case syntax.Number(token):
                return ex.Number(float(token.value))
            case syntax.ParamName(token):
                return self.param(token)
            case syntax.Minus(_, operand):
                return ex.Minus(self._expression(operand))
            case syntax.Arithmetic(left, operator, right):
                sign = cast("ex.Operator", operator.value)
                return ex.Arithmetic(sign, self._expression(left), self._expression(right))

    def param(self, token: Token) -> ex.ParamName:
        """A param, declared."""
        name = token.value
        if name not in self.names.params:
            self.report.unknown("M205", "param", token, self.names.params, self._difference(name))
        return ex.ParamName(name)

    def _difference(self, name: str) -> str | None:
        """A hint for ``win-fail``, which is one name, where both halves are params."""
        parts = name.split("-")
        for cut in range(1, len(parts)):
            left, right = "-".join(parts[:cut]), "-".join(parts[cut:])
            if left in self.names.params and (right in self.names.params or right.isdigit()):
                return f"`{name}` is one name; a difference has spaces: `{left} - {right}`"
        return None

    def value(self, expression: ex.Expression, node: object) -> float | None:
        """The value with the params as they are; None, and a report, if there is none."""
        values = self.names.params
        if any(values.get(name) is None for name in ex.params_in(expression)):
            return None
        try:
            return ex.evaluate(expression, cast("dict[str, float]", values))
        except ex.EvaluationError as error:
            self.report.error("M413", f"this expression has no value: {error}", node)
            return None

    def cell(self, node: syntax.Cell) -> ex.Expression:
        """A cell of a table."""
        match node:
            case syntax.Number(token):
                return ex.Number(float(token.value))
            case syntax.Fraction(numerator, denominator):
                for token in (numerator, denominator):
                    if not token.value.isdigit():
                        self.report.error(
                            "M430", "a fraction is of whole numbers", token,
                            f"write ({numerator.value} / {denominator.value})",
                        )  # fmt: skip
                left, right = float(numerator.value), float(denominator.value)
                fraction = ex.Arithmetic("/", ex.Number(left), ex.Number(right))
                self.value(fraction, node)
                return fraction
            case syntax.Parenthesised(expression):
                return self.expression(expression)
            case syntax.BareName(token):
                return self.param(token)

    def whole_number(self, token: Token) -> int:
        """A number without a fractional part."""
        value = float(token.value)
        if not token.value.isdigit() or not math.isfinite(value) or value > 1e15:
            self.report.error(
                "M430", f"`{shown(token.value)}` is no whole number", token,
                "only digits, and at most 1000000000000000",
            )  # fmt: skip
            return 0
        return int(value)


def signature(name: str, types: tuple[Types, ...]) -> str:
    """How a predicate is declared: ``in(pcb, bay)``."""
    return f"{name}({', '.join(' | '.join(union) for union in types)})" if types else name


def _types(types: Types) -> str:
    return " | ".join(f"`{name}`" for name in types)
