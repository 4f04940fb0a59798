"""A solver's own policy, played in an environment as a planner of others would play."""

from __future__ import annotations

import time
from dataclasses import replace

from menid_plan.errors import MenidError
from menid_plan.grounding.state import GroundAction, State
from menid_plan.planning import Task
from menid_plan.policy import Policy
from menid_plan.servers.play import Player, Results
from menid_plan.solving import Solver


class Decider:
    """Chooses by a policy, and in a state to which that does not lead by one for this state.

    An environment may do what the domain does not foresee.
    """

    def __init__(self, task: Task, solver: Solver) -> None:
        self._task, self._solver = task, solver
        self._policies: list[Policy] = []

    def action(self, state: State, left: int | None) -> GroundAction | None:
        """What to do with so many steps left (None: any number); None if nothing can be done."""
        for policy in self._policies:
            action = policy.action(state, left)
            if action is not None:
                return action
        task = self._task
        problem = replace(task.problem, init=tuple(sorted(state)), horizon=left)
        own = Task(task.domain, problem, task.environment, task.params, task.noise, task.max_states)
        own.build()
        self._policies.append(own.policy(own.solve(self._solver, task.objective)))
        return self._policies[-1].action(state, left)


def play(
    decider: Decider, name: str, player: Player, rounds: int, turns: int, seconds: float
) -> Results:
    """Play rounds of at most so many steps; what goes wrong ends them, and is in the results."""
    results = Results(client=name)
    horizon = player.spec.problem.horizon
    until = time.monotonic() + seconds
    try:
        while len(results.rounds) < rounds:
            player.begin()
            while not player.over and player.round.steps < turns:
                if time.monotonic() >= until:
                    results.failure = f"it was not done after {seconds:g} s"
                    return results
                left = None if horizon is None else horizon - player.round.steps
                action = decider.action(player.state, left)
                if action is None:
                    break
                player.act(action)
            results.rounds.append(player.end())
    except MenidError as error:
        results.failure = str(error)
    return results
