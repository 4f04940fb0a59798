"""What the servers and `menid plan` share: where rounds are played, how many, and for how long."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import environment_of, setting_option
from menid_plan.cli.exporting import goal_reward_option, with_goal_reward
from menid_plan.cli.tasks import files_argument, finite, gathered
from menid_plan.interrupts import tidied_up

if TYPE_CHECKING:
    from menid_plan.environments.registry import EnvironmentSpec
    from menid_plan.model.domain import Domain, Problem
    from menid_plan.planning import Task
    from menid_plan.servers.play import Player, Results
    from menid_plan.servers.wire import Wire


@dataclass(frozen=True, slots=True)
class RoundOptions:
    """Rounds in an environment: of a run file, or without one, of the domain, simulated."""

    run_file: str | None
    environment: str | None
    settings: Mapping[str, float]
    horizon: int | None
    goal_reward: float | None
    rounds: int
    seed: int
    seconds: float

    def spec(self, domain: Domain, problem: Problem) -> EnvironmentSpec:
        """The environment; its problem has the horizon and the goal's reward, if they are given."""
        from menid_plan.environments.registry import EnvironmentSpec
        from menid_plan.environments.runfile import read_run_file
        from menid_plan.environments.simulated import Simulated

        problem = with_goal_reward(problem, self.goal_reward)
        problem = replace(problem, horizon=self.horizon or problem.horizon)
        if self.run_file is None:
            target = self.environment or domain.target
            return EnvironmentSpec(target, Simulated(), domain, problem, params=self.settings)
        bound = read_run_file(self.run_file).bind(domain, problem, self.settings)
        return environment_of(bound, self.run_file, self.environment)


def round_options(function: Any) -> Any:
    """DOMAIN PROBLEM, and options that the command gets as ``play``, RoundOptions."""
    return gathered(
        function, "play", RoundOptions,
        files_argument,
        click.option("--run", "run_file", type=click.Path(exists=True, dir_okay=False),
                     metavar="FILE.toml", help="Act in an environment of this run file; by default "
                     "the domain is simulated."),
        click.option("--env", "environment", metavar="NAME",
                     help="The environment; by default the target."),
        setting_option,
        click.option("--horizon", type=click.IntRange(1, 1_000_000), metavar="H",
                     help="How many steps a round takes; by default as the problem has it."),
        goal_reward_option,
        click.option("--rounds", type=click.IntRange(1), default=30, show_default=True,
                     metavar="N"),
        click.option("--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S"),
        click.option("--time", "seconds", type=click.FloatRange(1, 1e6), default=1080.0,
                     callback=finite,
                     show_default=True, metavar="SECONDS", help="How long it may take in all."),
    )  # fmt: skip


def task_of(spec: EnvironmentSpec) -> Task:
    """What is to be solved or exported for those who act in an environment."""
    from menid_plan.planning import Task

    return Task(spec.domain, spec.problem, spec.name, dict(spec.params))


@dataclass(frozen=True, slots=True)
class ServerOptions:
    """How a server listens, how long it waits for a message, and for how many sessions."""

    sessions: int
    port: int
    patience: float

    def serve(
        self, spec: EnvironmentSpec, seed: int, play: Callable[[Wire, Player], Results]
    ) -> None:
        """Have sessions, and print what came of each; exit with 5 if one ended early."""
        from menid_plan.environments.seeds import seed_of
        from menid_plan.servers.listen import HOST, listening, sessions
        from menid_plan.servers.play import Player

        counted = count()

        def session(wire: Wire) -> Results:
            # What broke down in one session is built anew for the next.
            player = Player(spec, seed_of(seed, "session", next(counted)))
            try:
                return play(wire, player)
            finally:
                player.close()

        failed = False
        with tidied_up(), listening(self.port) as server:
            click.echo(f"listening on {HOST}:{server.getsockname()[1]}", err=True)
            for results in sessions(server, self.sessions, self.patience, session):
                click.echo(json.dumps(results.summary(), indent=2))
                failed = failed or bool(results.failure)
        if failed:
            click.get_current_context().exit(5)


def server_options(function: Any) -> Any:
    """Options that the command gets as ``server``, ServerOptions."""
    return gathered(
        function, "server", ServerOptions,
        click.option("--sessions", type=click.IntRange(1), default=1, show_default=True,
                     metavar="N", help="End after so many sessions."),
        click.option("--port", type=click.IntRange(0, 65535), default=2323, show_default=True,
                     help="The port on 127.0.0.1; 0: any that is free, which is told."),
        click.option("--patience", type=click.FloatRange(0.01, 1e6), default=300.0,
                     callback=finite,
                     show_default=True, metavar="SECONDS",
                     help="How long the client may take for a message."),
    )  # fmt: skip
