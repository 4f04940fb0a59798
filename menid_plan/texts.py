"""A task in the words of other planners: RDDL and PPDDL, in the first form that can say all of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from menid_plan.errors import LimitError
from menid_plan.exchange import ppddl, rddl
from menid_plan.exchange.classes import propositional
from menid_plan.exchange.flat import NotExpressibleError
from menid_plan.exchange.grounded import grounded
from menid_plan.exchange.lifted import lifted
from menid_plan.exchange.ppddl_states import ppddl_states
from menid_plan.grounding.semantics import Noise
from menid_plan.model.domain import Domain, Problem
from menid_plan.planning import Task

_Text = TypeVar("_Text")

PPDDL_FORMS = ("lifted", "grounded", "states")
RDDL_FORMS = ("lifted", "grounded")


@dataclass(frozen=True, slots=True)
class InForm(Generic[_Text]):
    """What was written, in which form, and why not in those before (empty if it is the first)."""

    written: _Text
    form: str
    reason: str = ""


def first_form(forms: Sequence[str], write: Callable[[str], _Text]) -> InForm[_Text]:
    """What is written in the first form in which all can be said.

    Raises NotExpressibleError or LimitError that says why it can be said in none.
    """
    reasons: list[str] = []
    last: NotExpressibleError | LimitError | None = None
    for form in forms:
        try:
            return InForm(write(form), form, reasons[0] if reasons else "")
        except (NotExpressibleError, LimitError) as error:
            last = error
            if str(error) not in reasons:
                reasons.append(str(error))
    assert last is not None
    if len(reasons) < 2:
        raise last
    raise NotExpressibleError("; ".join(reasons))


def rddl_text(
    task: Task, form: str, dialect: rddl.Dialect, horizon: int, *, stopping: bool = False
) -> rddl.Written:
    """The RDDL of a task, lifted or grounded, that is played for so many steps."""
    is_lifted = form == "lifted"
    flat = lifted(*_of(task), split=False) if is_lifted else propositional(grounded(*_of(task)))
    told = f"// {_origin(task, form)}, in the dialect {dialect}\n"
    if dialect == "prost":
        told += "// A step is two: first an action is chosen, and its outcome drawn;\n"
        told += "// in the second, while `applying` is true, the outcome takes effect.\n"
    written = rddl.rddl(flat, dialect, horizon, stopping=stopping)
    return replace(written, domain=told + written.domain)


def ppddl_text(
    task: Task, form: str, explore: Callable[[Task], object] = Task.explore
) -> ppddl.Written:
    """The PPDDL of a task, lifted, grounded, or by states, for which it is explored."""
    if form == "states":
        explore(task)
        written = ppddl_states(task.domain, task.problem, task.structure, task.mdp)
    else:
        written = ppddl.ppddl(lifted(*_of(task)) if form == "lifted" else grounded(*_of(task)))
    return replace(written, domain=f"; {_origin(task, form)}\n{written.domain}")


def _origin(task: Task, form: str) -> str:
    """What a reader of the text may want to know."""
    sinks = ", noise leads out of it" if task.noise == "sink" else ""
    how = "state by state" if form == "states" else form
    return (
        f"{task.domain.name} with the probabilities of environment {task.environment}, {how}{sinks}"
    )


def _of(task: Task) -> tuple[Domain, Problem, str, Mapping[str, float], Noise]:
    return task.domain, task.problem, task.environment, task.params, task.noise
