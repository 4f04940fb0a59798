"""A domain and a problem for people to read, at 80 columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from menid_plan.cli.common import table
from menid_plan.language.write import ranges
from menid_plan.model.domain import OBJECT, Domain, Object, Param, Problem
from menid_plan.model.formulas import TRUE
from menid_plan.model.rules import Action, Block, Outcome, Rule
from menid_plan.model.text import (
    cell_text,
    effects_text,
    expression_text,
    formula_text,
    number_text,
    variables_text,
)

_LABEL = 14


def show_domain(domain: Domain, console: Console) -> None:
    """Print a domain: its declarations, then a table for each rule."""
    _heading(console, f"domain {domain.name}", domain.doc)
    facts = _Facts()
    facts.add("params", _params(domain.params))
    facts.add("environments", ", ".join(f"{e.name} ({e.role})" for e in domain.all_environments))
    for parent in [OBJECT, *(t.name for t in domain.types)]:
        children = [t.name for t in domain.types if t.parent == parent]
        above = "" if parent == OBJECT else f" < {parent}"
        facts.add("types", f"{', '.join(children)}{above}" if children else "")
    facts.add_objects("constants", domain.constants)
    for predicate in domain.predicates:
        arguments = ", ".join(" | ".join(types) for types in predicate.arguments)
        facts.add("predicates", f"{predicate.name}({arguments})" if arguments else predicate.name)
    for derived in domain.derived:
        head = variables_text(derived.parameters)
        name = f"{derived.name}({head})" if head else derived.name
        facts.add("derived", f"{name} = {formula_text(derived.formula)}")
    for reward in domain.rewards:
        per = f" per {variables_text(reward.variables)}" if reward.variables else ""
        text = f"{expression_text(reward.reward)}{per} when {formula_text(reward.condition)}"
        facts.add("rewards", text)
    console.print(facts.table)
    for action in domain.actions:
        console.print()
        _action(action, domain, console)


def show_problem(problem: Problem, console: Console) -> None:
    """Print a problem."""
    _heading(console, f"problem {problem.name} for {problem.domain}", problem.doc)
    facts = _Facts()
    facts.add("params", _params(problem.params))
    facts.add_objects("objects", problem.objects)
    facts.add("init", ", ".join(str(atom) for atom in problem.init))
    if problem.goal is not None:
        reward = problem.goal_reward
        tail = "" if reward is None else f" reward {expression_text(reward)}"
        facts.add("goal", formula_text(problem.goal) + tail)
    if problem.dead_end_reward is not None:
        facts.add("dead end", f"reward {expression_text(problem.dead_end_reward)}")
    facts.add("horizon", "" if problem.horizon is None else str(problem.horizon))
    facts.add("discount", "" if problem.discount is None else number_text(problem.discount))
    console.print(facts.table)


class _Facts:
    """Labels and what they stand for; a label is shown once for several lines."""

    def __init__(self) -> None:
        self.table = Table(box=None, show_header=False, padding=(0, 1, 0, 0), pad_edge=False)
        self.table.add_column(width=_LABEL, style="dim")
        self.table.add_column(overflow="fold")
        self._label = ""

    def add(self, label: str, text: str) -> None:
        """A line, if there is anything to say."""
        if text:
            self.table.add_row("" if label == self._label else label, Text(text))
            self._label = label

    def add_objects(self, label: str, objects: Sequence[Object]) -> None:
        """A line for each type and set of attributes."""
        groups: dict[tuple[str, tuple[tuple[str, float], ...]], list[str]] = {}
        for item in objects:
            groups.setdefault((item.type, item.attributes), []).append(item.name)
        for (type_, attributes), names in groups.items():
            numbers = ", ".join(f"{key}: {value:g}" for key, value in attributes)
            shown = f" ({numbers})" if numbers else ""
            self.add(label, f"{', '.join(ranges(names))}: {type_}{shown}")


def _heading(console: Console, title: str, doc: str) -> None:
    console.print(Text(title, style="bold"))
    if doc:
        console.print(_prose(doc))


def _prose(doc: str) -> Text:
    """A comment as paragraphs: an empty line in it separates two."""
    paragraphs = [" ".join(part.split()) for part in doc.split("\n\n")]
    return Text("\n".join(paragraphs), style="italic")


def _params(params: Iterable[Param]) -> str:
    return ", ".join(f"{param.name} = {expression_text(param.value)}" for param in params)


def _action(action: Action, domain: Domain, console: Console) -> None:
    parameters = f"({variables_text(action.parameters)})" if action.parameters else ""
    cost = "" if action.cost is None else f"  cost {expression_text(action.cost)}"
    _heading(console, f"action {action.name}{parameters}{cost}", action.doc)
    for rule in action.rules:
        apart = f", one distribution per {', '.join(rule.per)}" if rule.per else ""
        console.print(Padding(Text(f"rule {rule.name}{apart}", style="bold"), (0, 0, 0, 2)))
        doc = [_prose(rule.doc)] if rule.doc else []
        for text in [*doc, *(Text(line) for line in _conditions(rule))]:
            console.print(Padding(text, (0, 0, 0, 4)))
        console.print(Padding(_outcomes(rule, domain, console), (0, 0, 0, 4)))
        for kind, blocks in (("probabilities", rule.probabilities), ("observed", rule.observed)):
            kept_apart = [block for block in blocks if block.values]
            if kept_apart:
                order = "/".join(outcome.name for outcome in rule.outcomes)
                title = Text(f"{kind}, by {', '.join(rule.per)}: {order}")
                console.print(Padding(title, (0, 0, 0, 4)))
                apart_table = _blocks(kept_apart, rule, domain, console)
                console.print(Padding(apart_table, (0, 0, 0, 4)))


def _conditions(rule: Rule) -> list[str]:
    lines = []
    if rule.otherwise:
        lines.append("otherwise")
    for reference in rule.references:
        variables = variables_text(reference.variables)
        lines.append(f"the {variables} where {formula_text(reference.formula)}")
    if rule.condition != TRUE:
        lines.append(f"when {formula_text(rule.condition)}")
    return lines


def _outcomes(rule: Rule, domain: Domain, console: Console) -> Table:
    shown = table(console)
    shown.add_column("outcome", no_wrap=True)
    environments = [e.name for e in domain.all_environments]
    shared = [block for block in rule.observed if not block.values]
    single = bool(rule.has_column and not rule.environments)
    heads = (
        ["every" if len(environments) > 1 else environments[0]] if _alike(rule) else environments
    )
    for name in heads:
        shown.add_column(name, justify="right", no_wrap=True)
    shown.add_column("effects", overflow="fold", ratio=1)
    if any(outcome.reward is not None for outcome in rule.outcomes):
        shown.add_column("reward", no_wrap=True)
    columns = [rule.probability_cells(name) for name in environments]
    counts = [_counts(shared, name, rule.outcomes) for name in environments]
    for index, outcome in enumerate(rule.outcomes):
        cells = [
            _cell(column[index] if column else None, count[index] if count else None)
            for column, count in zip(columns, counts, strict=True)
        ]
        if single and _alike(rule):
            cells = cells[:1]
        effects = "" if outcome.is_noise else effects_text(outcome.effects)
        reward = [] if outcome.reward is None else [expression_text(outcome.reward)]
        shown.add_row(outcome.name, *cells, Text(effects), *reward)
    return shown


def _alike(rule: Rule) -> bool:
    """Whether one column of probabilities is all that there is to show."""
    shared = any(not block.values for block in (*rule.probabilities, *rule.observed))
    return rule.has_column and not rule.environments and not shared


def _counts(
    blocks: Sequence[Block], environment: str, outcomes: Sequence[Outcome]
) -> list[str] | None:
    for block in blocks:
        if environment in block.environments:
            return [cell_text(cell) for cell in block.column(environment, outcomes)]
    return None


def _cell(probability: object, count: str | None) -> str:
    shown = "?" if probability is None else cell_text(probability)  # type: ignore[arg-type]
    return shown if count is None else f"{shown} ({count})"


def _blocks(blocks: Sequence[Block], rule: Rule, domain: Domain, console: Console) -> Table:
    """Blocks for values of `per`: a line for each value, its numbers in the order of outcomes."""
    shown = table(console)
    shown.add_column(", ".join(rule.per), no_wrap=True)
    names = [
        e.name for e in domain.all_environments if any(e.name in b.environments for b in blocks)
    ]
    for name in names:
        shown.add_column(name, overflow="fold")
    for values in dict.fromkeys(block.values for block in blocks):
        mine = [block for block in blocks if block.values == values]
        cells = [_counts(mine, name, rule.outcomes) for name in names]
        shown.add_row(", ".join(values), *("/".join(cell) if cell else "" for cell in cells))
    return shown
