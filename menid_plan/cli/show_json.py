"""What a domain and a problem declare, as JSON; formulas, effects and expressions as text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from menid_plan.model.domain import Domain, Object, Param, Problem
from menid_plan.model.formulas import TypedVariable
from menid_plan.model.rules import Action, Block, Rule
from menid_plan.model.text import (
    cell_text,
    effect_text,
    expression_text,
    formula_text,
    variables_text,
)

Json = dict[str, Any]


def domain_json(domain: Domain) -> Json:
    """A domain as `menid show --json` prints it."""
    return {
        "name": domain.name,
        "doc": domain.doc,
        "params": _params(domain.params),
        "environments": [{"name": e.name, "role": e.role} for e in domain.all_environments],
        "types": [{"name": t.name, "parent": t.parent} for t in domain.types],
        "constants": _objects(domain.constants),
        "predicates": [
            {"name": p.name, "arguments": [list(types) for types in p.arguments]}
            for p in domain.predicates
        ],
        "derived": [
            {
                "name": d.name,
                "parameters": _variables(d.parameters),
                "formula": formula_text(d.formula),
            }
            for d in domain.derived
        ],
        "rewards": [
            {
                "reward": expression_text(r.reward),
                "per": _variables(r.variables),
                "when": formula_text(r.condition),
            }
            for r in domain.rewards
        ],
        "actions": [_action(action) for action in domain.actions],
    }


def problem_json(problem: Problem) -> Json:
    """A problem as `menid show --json` prints it."""
    reward, dead_end = problem.goal_reward, problem.dead_end_reward
    return {
        "name": problem.name,
        "domain": problem.domain,
        "doc": problem.doc,
        "params": _params(problem.params),
        "objects": _objects(problem.objects),
        "init": [str(atom) for atom in problem.init],
        "goal": None if problem.goal is None else formula_text(problem.goal),
        "goal_reward": None if reward is None else expression_text(reward),
        "horizon": problem.horizon,
        "discount": problem.discount,
        "dead_end_reward": None if dead_end is None else expression_text(dead_end),
    }


def _params(params: Iterable[Param]) -> Json:
    return {param.name: expression_text(param.value) for param in params}


def _objects(objects: Iterable[Object]) -> list[Json]:
    return [{"name": o.name, "type": o.type, "attributes": dict(o.attributes)} for o in objects]


def _variables(variables: Iterable[TypedVariable]) -> list[Json]:
    return [{"name": v.name, "types": list(v.types)} for v in variables]


def _action(action: Action) -> Json:
    return {
        "name": action.name,
        "doc": action.doc,
        "parameters": _variables(action.parameters),
        "cost": None if action.cost is None else expression_text(action.cost),
        "rules": [_rule(rule) for rule in action.rules],
    }


def _rule(rule: Rule) -> Json:
    return {
        "name": rule.name,
        "doc": rule.doc,
        "per": list(rule.per),
        "otherwise": rule.otherwise,
        "references": [
            {"the": variables_text(r.variables), "where": formula_text(r.formula)}
            for r in rule.references
        ],
        "when": formula_text(rule.condition),
        "environments": list(rule.environments),
        "outcomes": [
            {
                "name": o.name,
                "cells": [cell_text(cell) for cell in o.cells],
                "effects": [effect_text(effect) for effect in o.effects],
                "reward": None if o.reward is None else expression_text(o.reward),
            }
            for o in rule.outcomes
        ],
        "probabilities": [_block(block) for block in rule.probabilities],
        "observed": [_block(block) for block in rule.observed],
    }


def _block(block: Block) -> Json:
    return {
        "for": list(block.values),
        "environments": list(block.environments),
        "rows": {name: [cell_text(cell) for cell in cells] for name, cells in block.rows},
    }
