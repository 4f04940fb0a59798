"""What a planner is given to play: the files that it reads, and a session in its protocol."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from menid_plan.exchange import ppddl, rddl
from menid_plan.servers import mdpsim, rddlsim
from menid_plan.servers.play import Player, Results
from menid_plan.servers.wire import Wire


@dataclass(frozen=True, slots=True)
class Game:
    """The texts of a domain and an instance, by the names of their files, and a session."""

    files: Mapping[str, str]
    play: Callable[[Wire, Player], Results]


def rddl_game(texts: rddl.Written, rounds: int, seconds: float) -> Game:
    """For a planner that reads RDDL, with the protocol of rddlsim."""
    return Game(
        {"domain.rddl": texts.domain, "instance.rddl": texts.instance},
        lambda wire, player: rddlsim.Session(wire, texts, player, rounds, seconds).run(),
    )


def ppddl_game(texts: ppddl.Written, rounds: int, turns: int, seconds: float) -> Game:
    """For a planner that reads PPDDL, with the protocol of mdpsim, and so many actions a round."""
    return Game(
        {"domain.pddl": texts.domain, "problem.pddl": texts.problem},
        lambda wire, player: mdpsim.Session(wire, texts, player, rounds, turns, seconds).run(),
    )
