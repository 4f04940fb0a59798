"""Why each action applies in a state or does not, and what its outcomes would change: as data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain, islice

from menid_plan.errors import LimitError
from menid_plan.grounding.reasons import failed_conjuncts
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import (
    SINK,
    Binding,
    GroundAction,
    NextState,
    State,
    World,
    binding_text,
    extended,
)
from menid_plan.grounding.steps import Covering, Reward, RuleConflict
from menid_plan.model.formulas import GroundAtom
from menid_plan.model.rules import Reference, Rule
from menid_plan.model.text import formula_text, variables_text
from menid_plan.model.variables import bound, replaced

CANDIDATES_SHOWN = 3

MAX_INSTANCES = 10_000
"""How many action instances are explained at once."""


@dataclass(frozen=True, slots=True)
class ResolvedReference:
    """What a deictic reference found.

    ``formula`` is its text with the objects already known; ``candidates`` binds its variables to
    the first few tuples that satisfy it, of ``count`` in all. It resolves if there is exactly one.
    """

    variables: str
    formula: str
    candidates: tuple[Binding, ...] = field(hash=False)
    count: int

    @property
    def resolves(self) -> bool:
        """Whether exactly one tuple satisfies the formula."""
        return self.count == 1

    @property
    def reason(self) -> str:
        """What was found, as a sentence."""
        asked = f"`the {self.variables} where {self.formula}`"
        found = "; ".join(binding_text(c) for c in self.candidates)
        if self.count == 0:
            return f"nothing satisfies {asked}"
        if self.count == 1:
            return f"{asked} is {found}"
        more = self.count - len(self.candidates)
        rest = f"; and {more} more" if more else ""
        return f"{asked} is ambiguous: {self.count} candidates ({found}{rest})"


@dataclass(frozen=True, slots=True)
class RuleExplanation:
    """Whether a rule covers the state for an action instance, and why not.

    ``references`` are those that were tried: none after the first that does not resolve. ``failed``
    has the text of each conjunct of the condition that does not hold, and the reason.
    """

    rule: str
    covers: bool
    reason: str
    references: tuple[ResolvedReference, ...] = ()
    failed: tuple[tuple[str, str], ...] = ()

    def as_json(self) -> dict[str, object]:
        """The rule as ``menid explain --json`` prints it."""
        return {"rule": self.rule, "covers": self.covers, "reason": self.reason}


@dataclass(frozen=True, slots=True)
class OutcomeExplanation:
    """What an outcome would change (of ``add`` nothing held before, all of ``delete`` did) and pay.

    ``probability`` has one entry per environment; None: unknown. ``ends`` says what the step would
    arrive in: ``goal``, ``dead end``, ``sink``, or ``""`` if the episode goes on.
    """

    name: str
    add: tuple[GroundAtom, ...]
    delete: tuple[GroundAtom, ...]
    reward: Reward
    probability: Mapping[str, float | None] = field(hash=False)
    ends: str = ""

    @property
    def changes_nothing(self) -> bool:
        """Whether the state would stay as it is."""
        return not self.add and not self.delete and self.ends != "sink"

    def as_json(self) -> dict[str, object]:
        """The outcome as ``menid explain --json`` prints it."""
        parts = self.reward
        return {
            "name": self.name,
            "add": [str(atom) for atom in self.add],
            "delete": [str(atom) for atom in self.delete],
            "reward": parts.total,
            "reward_parts": {
                "state": parts.state,
                "outcome": parts.outcome,
                "cost": parts.cost,
                "goal": parts.goal,
                "dead_end": parts.dead_end,
            },
            "probability": dict(self.probability),
            "ends": self.ends,
        }


@dataclass(frozen=True, slots=True)
class ActionExplanation:
    """One action instance: the rule that covers (None: it does not apply), and all that don't.

    ``conflict`` is the message if several rules cover; then ``rule`` is None.
    """

    action: GroundAction
    rule: str | None
    rules: tuple[RuleExplanation, ...]
    outcomes: tuple[OutcomeExplanation, ...] = ()
    conflict: str = ""

    @property
    def applies(self) -> bool:
        """Whether exactly one rule covers."""
        return self.rule is not None

    def as_json(self) -> dict[str, object]:
        """The action as ``menid explain --json`` prints it."""
        return {
            "action": str(self.action),
            "applies": self.applies,
            "rule": self.rule,
            "conflict": self.conflict or None,
            "rules": [rule.as_json() for rule in self.rules],
            "outcomes": [outcome.as_json() for outcome in self.outcomes],
        }


@dataclass(frozen=True, slots=True)
class Explanation:
    """A state, the atoms derived from it, and what was asked about its action instances."""

    state: tuple[GroundAtom, ...]
    derived: tuple[GroundAtom, ...]
    is_goal: bool
    is_dead_end: bool
    actions: tuple[ActionExplanation, ...]

    def as_json(self) -> dict[str, object]:
        """The explanation as ``menid explain --json`` prints it."""
        return {
            "state": [str(atom) for atom in self.state],
            "derived": [str(atom) for atom in self.derived],
            "goal": self.is_goal,
            "dead_end": self.is_dead_end,
            "actions": [action.as_json() for action in self.actions],
        }


def explain(
    semantics: Semantics, state: State, actions: Iterable[GroundAction] | None = None
) -> Explanation:
    """Explain a state: of each action instance, or of those given, which rule covers and why not.

    Raises MeaningError if a given one is no instance of an action of the domain, LimitError if there
    are more than MAX_INSTANCES and none is given.
    """
    if actions is None:
        instances = (semantics.instances(action) for action in semantics.domain.actions)
        actions = list(islice(chain.from_iterable(instances), MAX_INSTANCES + 1))
        if len(actions) > MAX_INSTANCES:
            raise LimitError(
                f"there are more than {MAX_INSTANCES} action instances, the limit of what is "
                "explained at once; ask for one of them, such as "
                f"`{actions[0]}`"
            )
    return Explanation(
        state=tuple(sorted(state)),
        derived=tuple(sorted(semantics.complete(state) - state)),
        is_goal=semantics.is_goal(state),
        is_dead_end=semantics.is_dead_end(state),
        actions=tuple(explain_action(semantics, state, ground) for ground in actions),
    )


def explain_action(semantics: Semantics, state: State, ground: GroundAction) -> ActionExplanation:
    """Explain one action instance in a state."""
    action = semantics.action_of(ground)
    arguments = extended({}, action.parameters, ground.arguments)
    coverings = semantics.coverings(state, ground)
    covering = coverings[0] if len(coverings) == 1 else None
    return ActionExplanation(
        action=ground,
        rule=covering.rule.name if covering else None,
        rules=tuple(
            _otherwise(rule, coverings)
            if rule.otherwise
            else _rule(semantics, rule, semantics.complete(state), arguments)
            for rule in action.rules
        ),
        outcomes=_outcomes(semantics, covering, state) if covering else (),
        conflict=str(RuleConflict(coverings, state)) if len(coverings) > 1 else "",
    )


def _otherwise(rule: Rule, coverings: list[Covering]) -> RuleExplanation:
    others = " and ".join(f"`{c.rule.name}`" for c in coverings if c.rule != rule)
    if others:
        verb = "covers" if len(coverings) == 1 else "cover"
        return RuleExplanation(rule.name, False, f"{others} {verb}")
    return RuleExplanation(rule.name, True, "no other rule covers")


def _rule(semantics: Semantics, rule: Rule, world: World, binding: Binding) -> RuleExplanation:
    """Explain a rule by resolving its references in turn, then looking at its condition."""
    references: list[ResolvedReference] = []
    for reference in rule.references:
        found = _reference(semantics, reference, world, binding)
        references.append(found)
        if not found.resolves:
            return RuleExplanation(rule.name, False, found.reason, tuple(references))
        binding = {**binding, **found.candidates[0]}
    failed = failed_conjuncts(semantics, rule.condition, world, binding)
    if failed:
        reason = "; ".join(why for _, why in failed)
    else:
        reason = f"covers with {binding_text(binding)}" if binding else "covers"
    return RuleExplanation(rule.name, not failed, reason, tuple(references), tuple(failed))


def _reference(
    semantics: Semantics, reference: Reference, world: World, binding: Binding
) -> ResolvedReference:
    variables = reference.variables
    found = semantics.satisfying(variables, reference.formula, world, binding)
    return ResolvedReference(
        variables=variables_text(variables),
        formula=formula_text(replaced(reference.formula, bound(binding))),
        candidates=tuple(extended({}, variables, objects) for objects in found[:CANDIDATES_SHOWN]),
        count=len(found),
    )


def _outcomes(
    semantics: Semantics, covering: Covering, state: State
) -> tuple[OutcomeExplanation, ...]:
    columns: dict[str, tuple[float, ...] | None] = {}
    for environment in (e.name for e in semantics.domain.all_environments):
        known = covering.rule.probability_cells(environment, covering.values) is not None
        columns[environment] = semantics.probabilities(covering, environment) if known else None
    explained = []
    for index, outcome in enumerate(covering.rule.outcomes):
        next_state = semantics.successor(covering, outcome, state)
        after = state if next_state is SINK else next_state
        explained.append(
            OutcomeExplanation(
                name=outcome.name,
                add=tuple(sorted(after - state)),
                delete=tuple(sorted(state - after)),
                reward=semantics.step_reward(covering, outcome, state, next_state),
                probability={e: p[index] if p else None for e, p in columns.items()},
                ends=_ends(semantics, next_state),
            )
        )
    return tuple(explained)


def _ends(semantics: Semantics, state: NextState) -> str:
    if state is SINK:
        return "sink"
    if semantics.is_goal(state):
        return "goal"
    return "dead end" if semantics.is_dead_end(state) else ""
