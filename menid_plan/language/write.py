"""From a Domain or Problem to its text, in the layout of ``menid fmt``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from menid_plan.language.declarations import MAX_RANGE
from menid_plan.language.layout import layout
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


def write(value: Domain | Problem) -> str:
    """The text of a domain or problem; reading it back gives an equal value."""
    lines = _domain(value) if isinstance(value, Domain) else _problem(value)
    return layout("\n".join(lines) + "\n")


def _doc(text: str) -> Iterator[str]:
    if text:
        # A blank line keeps the comment apart from the line before.
        yield ""
        yield from (f"# {line}".rstrip() for line in text.split("\n"))


def _domain(domain: Domain) -> Iterator[str]:
    yield from _doc(domain.doc)
    yield f"domain {domain.name}"
    yield from _params(domain.params)
    yield ""
    for name, parent, doc in _grouped((t.name, t.parent, t.doc) for t in domain.types):
        yield from _doc(doc)
        yield f"type {name}" + (f" < {parent}" if parent != OBJECT else "")
    yield ""
    yield from _objects("constant", domain.constants)
    yield ""
    for environment in domain.environments:
        yield from _doc(environment.doc)
        yield f"environment {environment.name} : {environment.role}"
    yield ""
    for predicate in domain.predicates:
        yield from _doc(predicate.doc)
        arguments = ", ".join(" | ".join(types) for types in predicate.arguments)
        yield f"predicate {predicate.name}" + (f"({arguments})" if arguments else "")
    yield ""
    for derived in domain.derived:
        yield from _doc(derived.doc)
        parameters = f"({variables_text(derived.parameters)})" if derived.parameters else ""
        yield f"derived {derived.name}{parameters} = {formula_text(derived.formula)}"
    yield ""
    for reward in domain.rewards:
        yield from _doc(reward.doc)
        per = f" per {variables_text(reward.variables)}" if reward.variables else ""
        condition = formula_text(reward.condition)
        yield f"reward {expression_text(reward.reward)}{per} when {condition}"
    for action in domain.actions:
        yield ""
        yield from _action(action)


def _params(params: Sequence[Param]) -> Iterator[str]:
    yield ""
    for param in params:
        yield from _doc(param.doc)
        yield f"param {param.name} = {expression_text(param.value)}"


def _grouped(items: Iterable[tuple[str, str, str]]) -> Iterator[tuple[str, str, str]]:
    """Names with the same type and comment, side by side, joined by commas."""
    group: list[str] = []
    common: tuple[str, str] | None = None
    for name, parent, doc in items:
        if common != (parent, doc) and common is not None:
            yield ", ".join(group), *common
            group = []
        common = (parent, doc)
        group.append(name)
    if common is not None:
        yield ", ".join(group), *common


def _objects(keyword: str, objects: Sequence[Object]) -> Iterator[str]:
    start = 0
    while start < len(objects):
        first = objects[start]
        end = start + 1
        while end < len(objects) and _alike(first, objects[end]):
            end += 1
        attributes = ", ".join(
            f"{name}: {'-' if value < 0 else ''}{number_text(abs(value))}"
            for name, value in first.attributes
        )
        yield from _doc(first.doc)
        names = ", ".join(ranges([o.name for o in objects[start:end]]))
        yield f"{keyword} {names}: {first.type}" + (f" ({attributes})" if attributes else "")
        start = end


def _alike(first: Object, other: Object) -> bool:
    return (first.type, first.attributes, first.doc) == (other.type, other.attributes, other.doc)


_NUMBERED = re.compile(r"(.*?)(0|[1-9][0-9]{0,17})", re.ASCII)


def ranges(names: Sequence[str]) -> Iterator[str]:
    """Names in order, runs of three or more such as n1, n2, n3 as ``n1..n3``."""
    start = 0
    while start < len(names):
        match = _NUMBERED.fullmatch(names[start])
        end = start + 1
        if match and not match[1][-1:].isdigit() and match[1]:
            number = int(match[2])
            # The reader takes ranges of so many objects, with numbers of so many digits.
            most = min(len(names), start + MAX_RANGE // 10, start + 10**18 - number)
            while end < most and names[end] == f"{match[1]}{number + end - start}":
                end += 1
        if end - start >= 3:
            yield f"{names[start]}..{names[end - 1]}"
        else:
            yield from names[start:end]
        start = end


def _action(action: Action) -> Iterator[str]:
    yield from _doc(action.doc)
    parameters = f"({variables_text(action.parameters)})" if action.parameters else ""
    cost = f" cost {expression_text(action.cost)}" if action.cost is not None else ""
    yield f"action {action.name}{parameters}{cost} {{"
    for rule in action.rules:
        yield from _rule(rule)
    yield "}"


def _rule(rule: Rule) -> Iterator[str]:
    yield from _doc(rule.doc)
    per = f" per {', '.join(rule.per)}" if rule.per else ""
    yield f"rule {rule.name}{per} {{"
    if rule.otherwise:
        yield "otherwise"
    for reference in rule.references:
        yield f"the {variables_text(reference.variables)} where {formula_text(reference.formula)}"
    if rule.condition != TRUE:
        yield f"when {formula_text(rule.condition)}"
    yield f"outcomes {' '.join(rule.environments)} {{"
    for outcome in rule.outcomes:
        if not outcome.is_noise or outcome.cells or outcome.reward is not None or outcome.doc:
            yield from _outcome(outcome)
    yield "}"
    for word, blocks in (("probabilities", rule.probabilities), ("observed", rule.observed)):
        for block in blocks:
            yield from _block(word, block)
    yield "}"


def _outcome(outcome: Outcome) -> Iterator[str]:
    yield from _doc(outcome.doc)
    cells = " ".join(cell_text(cell) for cell in outcome.cells)
    effects = "" if outcome.is_noise else effects_text(outcome.effects)
    reward = f"reward {expression_text(outcome.reward)}" if outcome.reward is not None else ""
    yield f"{outcome.name}: {cells} {effects} {reward}"


def _block(word: str, block: Block) -> Iterator[str]:
    yield from _doc(block.doc)
    values = f" for {', '.join(block.values)}" if block.values else ""
    yield f"{word} {' '.join(block.environments)}{values} {{"
    for name, cells in block.rows:
        yield f"{name}: {' '.join(cell_text(cell) for cell in cells)}"
    yield "}"


def _problem(problem: Problem) -> Iterator[str]:
    yield from _doc(problem.doc)
    yield f"problem {problem.name} for {problem.domain}"
    yield from _params(problem.params)
    yield ""
    yield from _objects("object", problem.objects)
    yield ""
    if problem.init:
        yield f"init {', '.join(str(atom) for atom in problem.init)}"
    if problem.goal is not None:
        reward = problem.goal_reward
        tail = f" reward {expression_text(reward)}" if reward is not None else ""
        yield f"goal {formula_text(problem.goal)}{tail}"
    if problem.dead_end_reward is not None:
        yield f"dead-end reward {expression_text(problem.dead_end_reward)}"
    if problem.horizon is not None:
        yield f"horizon {problem.horizon}"
    if problem.discount is not None:
        yield f"discount {number_text(problem.discount)}"
