"""The command `menid` and its list of subcommands, each loaded when it is called."""

from __future__ import annotations

import gc
import os
import sys
from typing import Any

try:
    import click

    from menid_plan import __version__
    from menid_plan.cli.common import report_diagnostics
    from menid_plan.cli.groups import LazyGroup
    from menid_plan.errors import InputError, MenidError
except KeyboardInterrupt:  # no traceback for who changes their mind at once
    print("menid: interrupted", file=sys.stderr)
    raise SystemExit(6) from None

_COMMANDS = {
    "check": "Report every error in domain and problem files.",
    "export": "Write a model in the languages of other planners.",
    "experiences": "Show what is in a store of experiences; export and import it.",
    "env": "Check environments; list the kinds that there are.",
    "delta": "Tell how far a distribution seen in counts may be off.",
    "explain": "Show which actions apply in a state, and why or why not.",
    "ground": "Count states and transitions; write the explicit model.",
    "fmt": "Bring files into the canonical layout.",
    "hdd": "Make meshes and record outcomes of the hard drive.",
    "import": "Translate a model of other planners into MENID.",
    "init": "Write a commented domain and problem to start from.",
    "doctor": "Say which planners of others are found, and how to get them.",
    "plan": "Let a planner act, and compare it with the best there is.",
    "serve": "Let planners of others act in an environment.",
    "simulate": "Draw episodes under a policy, and print what they earn.",
    "solve": "Find the best policy, with bounds on its value.",
    "solvers": "List the installed solvers, and what each promises.",
    "study": "Run a study: a table, a figure, and what they show.",
    "learn": "Learn how often outcomes happen, in several environments.",
    "estimate": "Tell what counts say of each rule; write it into the domain.",
    "report": "Write a page about learning runs: curves, rules, policy.",
    "render": "Write pictures of an execution in the hard-drive scenes.",
    "show": "Show what a file declares, each rule as a table.",
}


class _Main(LazyGroup):
    def invoke(self, ctx: click.Context) -> Any:
        for stream in (sys.stdout, sys.stderr):
            if hasattr(stream, "reconfigure"):  # what a terminal can't show is no reason to crash
                stream.reconfigure(errors="backslashreplace")
        # Grounding makes millions of objects that all stay: looking often for what does not costs
        # a quarter of the time.
        gc.set_threshold(100_000, 50, 50)
        try:
            return super().invoke(ctx)
        except InputError as error:
            report_diagnostics(error.diagnostics, err=True)
            ctx.exit(error.exit_code)
        except MenidError as error:
            click.echo(f"menid: {error}", err=True)
            ctx.exit(error.exit_code)
        except MemoryError:
            click.echo("menid: out of memory", err=True)
            ctx.exit(6)
        except KeyboardInterrupt:
            click.echo("menid: interrupted", err=True)
            ctx.exit(6)
        except BrokenPipeError:
            # The reader of our output is gone; keep Python from complaining about it at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            ctx.exit(0)
        except OSError as error:
            click.echo(f"menid: {error.filename or 'writing'}: {error.strerror or error}", err=True)
            ctx.exit(2)


@click.group(
    cls=_Main, module="menid_plan.cli.", texts=_COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip
@click.version_option(__version__, prog_name="menid")
def main() -> None:
    """Write what a robot's actions do, check it, and see what it means.

    DOMAIN and PROBLEM are .menid files; one file may hold both. `-` is standard input.

    Exit codes: 0 fine, 1 a negative answer, 2 wrong usage, 3 bad input, 4 not expressible in the
    target language, 5 a backend failed, 6 a limit was hit.
    """
