"""Checks actions and their rules: references, outcome tables, effects, blocks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from menid_plan.language import syntax
from menid_plan.language.check_formulas import FormulaChecker
from menid_plan.language.names import Names, Scope, Types
from menid_plan.language.report import Report, counted
from menid_plan.language.syntax import Token
from menid_plan.model.expressions import ZERO, Expression, evaluate, params_in
from menid_plan.model.formulas import TRUE, Atom
from menid_plan.model.probabilities import TOLERANCE, fault
from menid_plan.model.rules import (
    NOISE,
    Action,
    Block,
    ConditionalEffect,
    Effect,
    Literal,
    Outcome,
    Reference,
    Rule,
    UniversalEffect,
)


class RuleChecker(FormulaChecker):
    """Actions and rules of a domain; ``doc`` gives the comment above a token."""

    def __init__(self, report: Report, names: Names, doc: Callable[[Token], str]) -> None:
        super().__init__(report, names)
        self.doc = doc

    # -------------------------------------------------------------------------------- actions

    def action(self, node: syntax.Action) -> Action:
        """An action and all its rules."""
        parameters, scope = self.variables(node.parameters, {})
        cost = self.expression(node.cost) if node.cost else None
        seen: dict[str, Token] = {}
        fallback: Token | None = None
        rules = []
        for rule in node.rules:
            self._once("rule", rule.name, seen)
            if rule.context.otherwise is not None:
                if fallback is not None:
                    self.report.error(
                        "M408", f"action `{node.name.value}` has two `otherwise` rules", rule.name,
                        f"`{fallback.value}` is the other",
                    )  # fmt: skip
                fallback = rule.name
            rules.append(self.rule(rule, scope))
        return Action(
            node.name.value, tuple(rules), parameters, cost, self.doc(node.keyword),
            self.report.span(node.keyword, node.name),
        )  # fmt: skip

    def _once(self, kind: str, token: Token, seen: dict[str, Token]) -> bool:
        first = seen.setdefault(token.value, token)
        if first is not token:
            self.report.duplicate(kind, token, first)
        return first is token

    # ---------------------------------------------------------------------------------- rules

    def rule(self, node: syntax.Rule, scope: Scope) -> Rule:
        """A rule, in the scope of its action's parameters."""
        per = self._per(node.per or [], scope)
        per_types = [scope.get(name, ()) for name in per]
        references = []
        for reference in node.context.references:
            declared, scope = self.variables(reference.variables, scope)
            formula = self.formula(reference.formula, scope)
            span = self.report.span(reference.keyword, reference.formula)
            references.append(Reference(declared, formula, span))
        condition = self.formula(node.context.condition, scope) if node.context.condition else TRUE
        heads = self._environments(node.outcomes.environments)
        outcomes = self._outcomes(node.outcomes, heads, scope, node.whole)
        names = [outcome.name for outcome in outcomes]
        probabilities: list[Block] = []
        observed: list[Block] = []
        for block in node.blocks:
            checked = self._block(block, names, per, node.whole)
            self._constants_fit(block, per_types)
            (probabilities if isinstance(block, syntax.Probabilities) else observed).append(checked)
        rule = Rule(
            node.name.value, outcomes, per, tuple(references), condition,
            node.context.otherwise is not None, heads, tuple(probabilities), tuple(observed),
            self.doc(node.keyword), self.report.span(node.keyword, node.name),
        )  # fmt: skip
        self._blocks_once(node, rule)
        return rule

    def _per(self, tokens: list[Token], parameters: Scope) -> tuple[str, ...]:
        seen: dict[str, Token] = {}
        for token in tokens:
            self._once("`per` parameter", token, seen)
            if token.value not in parameters:
                self.report.unknown(
                    "M209", "action parameter", token, parameters,
                    None if parameters else "`per` names parameters of the action; it has none",
                )  # fmt: skip
        return tuple(token.value for token in tokens)

    def _environments(self, tokens: list[Token], per: tuple[str, ...] = ()) -> tuple[str, ...]:
        seen: dict[str, Token] = {}
        for token in tokens:
            self._once("the column for environment", token, seen)
            if token.value not in self.names.environments:
                hint = None
                if token.value in per:
                    hint = f"an object that `{token.value}` can be stands behind `for`"
                self.report.unknown("M206", "environment", token, self.names.environments, hint)
        return tuple(token.value for token in tokens)

    # -------------------------------------------------------------------------- outcome tables

    def _outcomes(
        self, node: syntax.Outcomes, heads: tuple[str, ...], scope: Scope, complete: bool
    ) -> tuple[Outcome, ...]:
        """The outcomes of a table; ``complete`` unless rows were left out of it."""
        seen: dict[str, Token] = {}
        outcomes: list[Outcome] = []
        noise: Outcome | None = None
        width = len(heads) if heads else self._width_without_head(node)
        for row in node.rows:
            self._once("outcome", row.name, seen)
            outcome, whole = self._row(row, width, bool(heads), scope)
            complete = complete and whole
            if outcome.is_noise:
                noise = outcome
                if row is not node.rows[-1]:
                    self.report.error("M405", "`noise` comes last", row.name, "move it to the end")
            else:
                outcomes.append(outcome)
        every = (*outcomes, noise or Outcome(NOISE))
        if complete and width and node.rows:
            self._check_columns(node, every, width)
        return every

    def _width_without_head(self, node: syntax.Outcomes) -> int:
        """A table without environments has one column if any row has a cell, else none."""
        return int(any(row.items and self._is_cell(row.items[0]) for row in node.rows))

    def _is_cell(self, item: syntax.Item, *, wanted: bool = False) -> bool:
        """Whether an item is a cell; if one is wanted, a name that nothing declares is one too."""
        match item:
            case syntax.Number() | syntax.Fraction() | syntax.Parenthesised():
                return True
            case syntax.BareName(token):
                known = self.names.arguments(token.value) is not None
                return token.value in self.names.params or (wanted and not known)
            case _:
                return False

    def _row(
        self, row: syntax.Row, width: int, has_head: bool, scope: Scope
    ) -> tuple[Outcome, bool]:
        """The outcome of a row, and whether it has the right number of cells."""
        items = row.items
        items, whole = self._strays(items, width)
        count = 0
        while count < len(items) and self._is_cell(items[count], wanted=count < width):
            count += 1
        cells = tuple(self.cell(cast("syntax.Cell", item)) for item in items[:count])
        if count != width:
            self._wrong_width(row, width, count, has_head)
        for item, cell in zip(items[:count], cells, strict=True):
            value = self.value(cell, item)
            if value is not None and value < 0:
                self.report.error("M403", f"a negative probability ({value:g})", item)
            elif value is not None and value > 1 + TOLERANCE:
                self.report.error("M404", f"a probability above 1 ({value:g})", item)
        effects = self._effects(row, items[count:], scope)
        reward = self.expression(row.reward) if row.reward else None
        outcome = Outcome(
            row.name.value, cells, effects, reward, self.doc(row.name), self.report.span(row.name)
        )
        return outcome, whole and count == width

    def _strays(self, items: list[syntax.Item], width: int) -> tuple[list[syntax.Item], bool]:
        """Items without what is reported here: commas between cells, and a row without its colon.

        The second value is whether nothing was left out but commas.
        """
        cells = 0
        kept: list[syntax.Item] = []
        commas = []
        for index, item in enumerate(items):
            following = items[index + 1] if index + 1 < len(items) else None
            before_cell = following is not None and self._is_cell(following)
            is_comma = isinstance(item, Token) and item.type == "COMMA"
            if is_comma and kept and len(kept) == cells and (before_cell or cells == width):
                commas.append(item)
                continue
            if isinstance(item, syntax.BareName) and before_cell and cells >= width and width:
                self.report.error(
                    "M418", f"the name of a row is followed by `:`: `{item.token.value}:`", item,
                    "or is a comma missing before an effect?",
                )  # fmt: skip
                return kept, False
            cells += self._is_cell(item) and len(kept) == cells
            kept.append(item)
        if commas:
            self.report.error(
                "M417", "no comma between the probabilities, nor behind them", commas[0],
                "spaces separate the columns; commas separate effects",
            )  # fmt: skip
        return kept, True

    def _wrong_width(self, row: syntax.Row, width: int, count: int, has_head: bool) -> None:
        columns = counted(width, "probability", "probabilities")
        hint = "the head of the table names one environment for each column"
        if not has_head:
            hint = "without environments in its head a table has one column, or none"
        place = row.items[:count] or row.name
        self.report.error("M401", f"expected {columns}, found {count or 'none'}", place, hint)

    def _check_columns(
        self, node: syntax.Outcomes, outcomes: tuple[Outcome, ...], width: int
    ) -> None:
        for index in range(width):
            cells = [o.cells[index] for o in outcomes if o.cells]
            place = node.environments[index] if node.environments else node.keyword
            name = f" of `{place.value}`" if node.environments else ""
            noise = outcomes[-1].cells
            self._check_sum(cells, f"the column{name}", place, noise[index] if noise else ZERO)

    def _check_sum(
        self, cells: list[Expression], what: str, place: Token, noise: Expression = ZERO
    ) -> None:
        values = cast("dict[str, float]", self.names.params)
        if any(values.get(name) is None for cell in cells for name in params_in(cell)):
            return
        reason = fault(cells, values)
        if reason is None or not reason.startswith("sums"):
            return  # what is wrong with a single cell is said of that cell
        rest = 1 - sum(evaluate(cell, values) for cell in cells)
        missing = round(rest + evaluate(noise, values), 9)
        hint = f"what no row describes is `noise: {missing:g}`" if rest > 0 else None
        self.report.error("M402", f"{what} {reason}", place, hint)

    # -------------------------------------------------------------------------------- effects

    def _effects(
        self, row: syntax.Row, items: list[syntax.Item], scope: Scope
    ) -> tuple[Effect, ...]:
        noise = row.name.value == NOISE
        if not items:
            if not noise:
                self.report.error(
                    "M416", f"outcome `{row.name.value}` has no effects", row.name,
                    "write `nothing` if it changes nothing",
                )  # fmt: skip
            return ()
        if noise:
            self.report.error(
                "M406",
                "`noise` has no effects",
                items,
                "leave `nothing` out: it goes without saying"
                if len(items) == 1 and isinstance(items[0], Token)
                else "it stands for whatever no row describes; give what you can describe a name",
            )  # fmt: skip
            return ()
        self._punctuation(items)
        effects: list[Effect] = []
        alone = sum(not isinstance(item, Token) or item.type != "COMMA" for item in items) == 1
        for item in items:
            match item:
                case syntax.Token(type="NOTHING") if not alone:
                    self.report.error("M417", "`nothing` stands alone", item)
                case syntax.Token():
                    pass
                case syntax.Number() | syntax.Fraction() | syntax.Parenthesised():
                    self.report.error(
                        "M401", "a probability after the effects", item,
                        "the probabilities come first, one for each column",
                    )  # fmt: skip
                case syntax.BareName(token):
                    effects.append(self._literal(syntax.Atom(token, []), scope))
                case syntax.Atom() | syntax.Negated():
                    effects.append(self._literal(item, scope))
                case syntax.Conditional(condition, literals):
                    formula = self.formula(condition, scope)
                    effects.append(ConditionalEffect(formula, self._literals(literals, scope)))
                case syntax.ForEach(variables, condition, literals):
                    declared, inner = self.variables(variables, scope)
                    formula = self.formula(condition, inner)
                    body = self._literals(literals, inner)
                    effects.append(UniversalEffect(declared, formula, body))
        return tuple(effects)

    def _punctuation(self, items: list[syntax.Item]) -> None:
        """Exactly one comma between two effects, none before the first or after the last."""
        previous: Any = None
        for item in items:
            comma = isinstance(item, Token) and item.type == "COMMA"
            after_comma = previous is None or (
                isinstance(previous, Token) and previous.type == "COMMA"
            )
            if comma and after_comma:
                hint = (
                    "no comma between the probabilities and the effects" if not previous else None
                )
                self.report.error("M417", "a comma without an effect before it", item, hint)
            elif not comma and not after_comma and not isinstance(item, syntax.Number):
                self.report.error("M417", "expected `,` before this effect", item)
            previous = item
        if isinstance(previous, Token) and previous.type == "COMMA" and len(items) > 1:
            self.report.error("M417", "a comma without an effect after it", previous)

    def _literals(
        self, nodes: list[syntax.Atom | syntax.Negated], scope: Scope
    ) -> tuple[Literal, ...]:
        return tuple(self._literal(node, scope) for node in nodes)

    def _literal(self, node: syntax.Atom | syntax.Negated, scope: Scope) -> Literal:
        negated = isinstance(node, syntax.Negated)
        atom = node.atom if isinstance(node, syntax.Negated) else node
        checked: Atom = self.atom(atom, scope, basic_for="an effect")
        return Literal(checked, not negated)

    # --------------------------------------------------------------------------------- blocks

    def _block(
        self, node: syntax.Block, outcomes: list[str], per: tuple[str, ...], complete: bool
    ) -> Block:
        word = node.keyword.value
        if not node.environments:
            self.report.error(
                "M206", f"`{word}` names no environment", node.keyword,
                f"write `{word} {' '.join(self.names.environments)} {{ ... }}`",
            )  # fmt: skip
        environments = self._environments(node.environments, per)
        values = tuple(token.value for token in node.values or [])
        if node.values is not None and len(values) != len(per):
            wanted = f"one value for each of: {', '.join(per)}" if per else "no values"
            given = counted(len(values), "value")
            self.report.error(
                "M412", f"`for` gives {given}, but the rule takes {wanted}", node.values,
                None if per else "write `per` behind the rule's name to keep distributions apart",
            )  # fmt: skip
        elif node.values is None and per and isinstance(node, syntax.Observed):
            self.report.error(
                "M411", "`observed` in a `per` rule needs `for`", node.keyword,
                f"write `observed {' '.join(environments)} for VALUE {{`, VALUE an object that "
                f"`{', '.join(per)}` can be",
            )  # fmt: skip
        rows = self._block_rows(node, outcomes)
        last = node.values[-1] if node.values else (node.environments or [node.keyword])[-1]
        block = Block(
            environments, values, tuple(rows), self.doc(node.keyword),
            self.report.span(node.keyword, last),
        )  # fmt: skip
        if (
            complete
            and isinstance(node, syntax.Probabilities)
            and all(len(cells) == len(environments) for _, cells in rows)
        ):
            for index, token in enumerate(node.environments):
                column = [cells[index] for _, cells in rows]
                self._check_sum(column, f"the column of `{token.value}`", token)
        return block

    def _constants_fit(self, node: syntax.Block, asked: list[Types]) -> None:
        """A constant in `for` is of its parameter's type; what is no constant is not known here."""
        for token, types in zip(node.values or [], asked, strict=False):
            given = self.names.objects.get(token.value)
            if given is not None and types and not self.names.fits((given,), types):
                self.report.error(
                    "M303", f"`{token.value}` is of type `{given}`, but the parameter is of type "
                    + " | ".join(f"`{name}`" for name in types), token,
                )  # fmt: skip

    def _block_rows(
        self, node: syntax.Block, outcomes: list[str]
    ) -> list[tuple[str, tuple[Expression, ...]]]:
        seen: dict[str, Token] = {}
        rows = []
        counts = isinstance(node, syntax.Observed)
        for row in node.rows:
            self._once("the row", row.name, seen)
            if row.name.value not in outcomes:
                self.report.unknown("M207", "outcome", row.name, outcomes)
            if node.environments and len(row.cells) != len(node.environments):
                noun = ("count", "counts") if counts else ("probability", "probabilities")
                wanted = counted(len(node.environments), *noun)
                self.report.error(
                    "M401",
                    f"expected {wanted}, found {len(row.cells) or 'none'}",
                    row.cells or row.name,
                    "one for each environment in the head of the block",
                )
            cells = []
            for item in row.cells:
                if counts and not isinstance(item, syntax.Number):
                    self.report.error("M419", "a count is a plain number", item)
                cell = self.cell(item)
                value = self.value(cell, item)
                if value is not None and value < 0:
                    self.report.error("M403", f"a negative probability ({value:g})", item)
                cells.append(cell)
            rows.append((row.name.value, tuple(cells)))
        return rows

    def _blocks_once(self, node: syntax.Rule, rule: Rule) -> None:
        seen: set[tuple[str, str, tuple[str, ...]]] = set()
        for block in node.blocks:
            word = block.keyword.value
            values = tuple(token.value for token in block.values or [])
            for token in block.environments:
                key = (word, token.value, values)
                if key in seen:
                    where = f" for {', '.join(values)}" if values else ""
                    self.report.error(
                        "M409", f"a second `{word}` of `{token.value}`{where}", token,
                        "join the two blocks",
                    )  # fmt: skip
                seen.add(key)
                if (
                    word == "probabilities"
                    and block.values is None
                    and rule.has_column
                    and (not rule.environments or token.value in rule.environments)
                ):
                    self.report.error(
                        "M410",
                        f"`{token.value}` has a column of `outcomes` already", token,
                        "leave one of the two out",
                    )  # fmt: skip
