"""`menid serve`: an environment for planners that ask over a connection."""

from __future__ import annotations

import click

from menid_plan.cli.groups import LazyGroup

_PROTOCOLS = {
    "mdpsim": "The protocol of mdpsim, for planners that read PPDDL.",
    "rddlsim": "The protocol of rddlsim, which PROST speaks.",
}


@click.group(
    "serve", cls=LazyGroup, module="menid_plan.cli.serve_", texts=_PROTOCOLS, heading="Protocols"
)
def command() -> None:
    """Let a planner act in an environment, over a connection on this machine."""
