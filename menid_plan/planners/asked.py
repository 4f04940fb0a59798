"""A planner of others as a solver: it is asked which action is best now, and plays no further."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.simulated import Simulated
from menid_plan.grounding.state import GroundAction
from menid_plan.model.domain import Domain, Problem
from menid_plan.planners.games import ppddl_game, rddl_game
from menid_plan.planners.known import PlannerError, planner
from menid_plan.planners.run import run
from menid_plan.planning import Task
from menid_plan.servers.play import Player
from menid_plan.texts import PPDDL_FORMS, RDDL_FORMS, first_form, ppddl_text, rddl_text

MOST_STEPS = 1_000_000
MOST_SECONDS = 1e6


class PlannerFailedError(PlannerError):
    """A planner ended, or took all its time, before it chose an action."""

    exit_code = 5


class _Answer(Exception):  # noqa: N818 - it is what was hoped for
    def __init__(self, action: GroundAction) -> None:
        super().__init__(str(action))
        self.action = action


class _Question(Player):
    """A player whose first action is the answer."""

    def act(self, action: GroundAction) -> float:
        raise _Answer(action)


@dataclass(frozen=True, slots=True)
class Asked:
    """Asks a planner of others for every action, which it plans for anew.

    ``planner`` is prost, or the name of one that is declared. It gets RDDL, or PPDDL if it speaks the
    protocol of mdpsim, in which the present state is the initial one, and looks ``horizon`` steps
    ahead, or as many as are left. An answer may take ``seconds``. With ``draw`` it plans for a model
    drawn from what is believed, as posterior sampling does (Thompson 1933; Strens 2000); without, for
    the expected one.
    """

    name: ClassVar[str] = "planner"
    promise: ClassVar[str] = (
        "what a planner of others promises (`menid doctor` tells which are there)"
    )
    needs: ClassVar[str] = ""

    planner: str = "prost"
    horizon: int = 20
    seconds: float = 60.0
    draw: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.planner, str):
            raise ValueError(f"planner must be a name, not {self.planner}")
        if type(self.horizon) is not int or not 1 <= self.horizon <= MOST_STEPS:
            raise ValueError(
                f"horizon must be a whole number from 1 to {MOST_STEPS}, not {self.horizon}"
            )
        if type(self.seconds) not in (int, float) or not 0.0 < self.seconds <= MOST_SECONDS:
            raise ValueError(
                f"seconds must be above 0, and at most {MOST_SECONDS:g}, not {self.seconds}"
            )
        if type(self.draw) is not bool:
            raise ValueError(f"draw must be true or false, not {self.draw}")

    def check(self) -> None:
        """Raise PlannerError or PlannerMissingError if the planner is not known, or not there."""
        planner(self.planner)

    def choose(
        self, domain: Domain, problem: Problem, params: Mapping[str, float]
    ) -> GroundAction | None:
        """The action that the planner chooses in the problem's initial state.

        Raises PlannerFailedError where it chooses none.
        """
        chosen = planner(self.planner)
        task = Task(domain, problem, params=params)
        steps = min(self.horizon, problem.horizon or self.horizon)
        if chosen.protocol == "mdpsim":
            pddl = first_form(PPDDL_FORMS, lambda form: ppddl_text(task, form))
            game = ppddl_game(pddl.written, 1, steps, self.seconds)
        else:
            texts = first_form(RDDL_FORMS, lambda form: rddl_text(task, form, "prost", steps))
            game = rddl_game(texts.written, 1, self.seconds)
        spec = EnvironmentSpec(task.environment, Simulated(), domain, problem, params=params)
        player = _Question(spec)
        try:
            found = run(chosen, game.files, lambda wire: game.play(wire, player), self.seconds)
        except _Answer as answer:
            return answer.action
        finally:
            player.close()
        said = f": {found.output.strip()}" if found.output.strip() else ""
        reason = found.failure or "it chose no action that applies"
        raise PlannerFailedError(f"the planner `{self.planner}` failed: {reason}{said}")


@dataclass(frozen=True, slots=True)
class Prost(Asked):
    """PROST (Keller and Eyerich 2012), asked for every action; see the solver `planner`."""

    name: ClassVar[str] = "prost"
    promise: ClassVar[str] = "what PROST promises (`menid doctor` tells how to get it)"
    needs: ClassVar[str] = ""
