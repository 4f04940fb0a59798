"""An explanation for people to read, at 80 columns."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from menid_plan.cli.common import table
from menid_plan.grounding.explain import (
    ActionExplanation,
    Explanation,
    OutcomeExplanation,
    RuleExplanation,
)
from menid_plan.model.formulas import GroundAtom

# Without --verbose no more derived atoms, and actions that do not apply, are listed.
_LISTED = 12


def show_state(
    explanation: Explanation, console: Console, *, list_actions: bool, verbose: bool
) -> None:
    """Print the state and, if asked, which actions apply in it."""
    console.print(_fact("state", _atoms(explanation.state) or "no atom holds"))
    derived = explanation.derived
    if len(derived) > _LISTED and not verbose:
        more = f", and {len(derived) - _LISTED} more; --verbose lists them"
        console.print(_fact("derived", _atoms(derived[:_LISTED]) + more))
    elif derived:
        console.print(_fact("derived", _atoms(derived)))
    if explanation.is_goal:
        console.print(_fact("goal", "holds here: an episode ends"))
    if explanation.is_dead_end:
        console.print(_fact("dead end", "no action applies"))
    if not list_actions:
        return
    applying = [action for action in explanation.actions if action.applies]
    others = [action for action in explanation.actions if not action.applies]
    console.print()
    console.print(Text(f"applies: {len(applying)} of {len(explanation.actions)}", style="bold"))
    for action in applying:
        console.print(Text(f"  {action.action}, by rule {action.rule}"))
    if others:
        console.print(Text("does not apply", style="bold"))
    for action in others if verbose else others[:_LISTED]:
        console.print(Padding(Text(f"{action.action}: {_why_not(action)}"), (0, 0, 0, 2)))
    if len(others) > _LISTED and not verbose:
        console.print(f"  and {len(others) - _LISTED} more; --verbose lists them")


def show_action(action: ActionExplanation, console: Console) -> None:
    """Print one action: each rule, and the outcomes of the one that covers."""
    if action.conflict:
        console.print(Text(f"{action.action}: error, {action.conflict}", style="bold"))
    elif action.applies:
        console.print(Text(f"{action.action} applies, by rule {action.rule}", style="bold"))
    else:
        console.print(Text(f"{action.action} does not apply", style="bold"))
    for rule in action.rules:
        _rule(rule, console)
    if action.outcomes:
        console.print(Padding(_outcomes(action.outcomes, console), (1, 0, 0, 2)))
        _parts(action.outcomes, console)


def _fact(label: str, text: str) -> Text:
    return Text.assemble((f"{label}: ", "bold"), text)


def _atoms(atoms: Iterable[GroundAtom]) -> str:
    return ", ".join(str(atom) for atom in atoms)


def _why_not(action: ActionExplanation) -> str:
    if action.conflict:
        return f"error, {action.conflict}"
    if len(action.rules) == 1:
        return action.rules[0].reason
    return "; ".join(f"rule {rule.rule}: {rule.reason}" for rule in action.rules)


def _rule(rule: RuleExplanation, console: Console) -> None:
    verb = "covers" if rule.covers else "does not cover"
    console.print(Text(f"  rule {rule.rule} {verb}"))
    for reference in rule.references:
        console.print(Padding(Text(reference.reason), (0, 0, 0, 4)))
    for text, why in rule.failed:
        part = "the condition" if f"`{text}`" in why else f"`{text}`"
        console.print(Padding(Text(f"{part} fails: {why}"), (0, 0, 0, 4)))
    if not rule.references and not rule.failed and rule.reason != "covers":
        console.print(Padding(Text(rule.reason.removeprefix("covers ")), (0, 0, 0, 4)))


def _outcomes(outcomes: tuple[OutcomeExplanation, ...], console: Console) -> Table:
    shown = table(console, gap=2)
    shown.add_column("outcome", no_wrap=True)
    for environment in outcomes[0].probability:
        shown.add_column(environment, justify="right", no_wrap=True)
    shown.add_column("reward", justify="right", no_wrap=True)
    shown.add_column("changes", overflow="fold", ratio=1)
    for outcome in outcomes:
        cells = [_number(p) for p in outcome.probability.values()]
        changes = [f"+ {atom}" for atom in outcome.add] + [f"- {atom}" for atom in outcome.delete]
        text = ", ".join(changes) or "nothing"
        if outcome.ends:
            text += f" (arrives in the {outcome.ends})"
        shown.add_row(outcome.name, *cells, f"{outcome.reward.total:g}", Text(text))
    return shown


def _number(probability: float | None) -> str:
    return "?" if probability is None else f"{probability:.4g}"


def _parts(outcomes: tuple[OutcomeExplanation, ...], console: Console) -> None:
    """What the rewards are made of, where it is not the outcome's alone."""
    first = outcomes[0].reward
    parts = []
    if first.state:
        parts.append(f"{first.state:g} for being in this state")
    if first.cost:
        parts.append(f"{-first.cost:g} for the cost of the action")
    arrivals = {o.reward.goal for o in outcomes if o.reward.goal}
    parts += [f"{reward:g} on arrival in the goal" for reward in arrivals]
    arrivals = {o.reward.dead_end for o in outcomes if o.reward.dead_end}
    parts += [f"{reward:g} on arrival in a dead end" for reward in arrivals]
    if parts:
        console.print(Text(f"  included in the rewards: {', '.join(parts)}"))
