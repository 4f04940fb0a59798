"""Explicit models: PRISM's files and Storm's DRN, state by state.

PRISM (Kwiatkowska, Norman, Parker 2011): ``.tra`` transitions, ``.sta`` states, ``.lab`` labels,
``.srew`` and ``.trew`` rewards of states and of transitions. DRN is the direct encoding of Storm
(Hensel et al. 2022), with rewards of states and of state-action pairs.

A state that ends an episode gets one choice that stays there, since these tools demand one.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from menid_plan.files import replacing
from menid_plan.grounding.state import SINK, NextState
from menid_plan.mdp.explore import Structure
from menid_plan.mdp.model import MDP


def model_paths(base: Path) -> list[Path]:
    """The files in which a model is written: BASE if that is ``.drn``, else BASE.tra and so on."""
    if _is_drn(base):
        return [base]
    return [base.with_name(base.name + suffix) for suffix in _PRISM]


def write_model(structure: Structure, mdp: MDP, base: Path) -> None:
    """Write the model to `model_paths`, as DRN or in PRISM's files: all of them or none.

    The reward model ``reward`` in DRN has what each choice pays on average.
    """
    formats = [_drn] if _is_drn(base) else list(_PRISM.values())
    with ExitStack() as written:
        for path, lines in zip(model_paths(base), formats, strict=True):
            stream = io.TextIOWrapper(written.enter_context(replacing(path)), "ascii")
            stream.writelines(f"{line}\n" for line in lines(structure, mdp))
            stream.detach()


def _is_drn(base: Path) -> bool:
    return base.suffix.lower() == ".drn"


def _choices(mdp: MDP, state: int) -> range:
    return range(int(mdp.state_row[state]), int(mdp.state_row[state + 1]))


def _merged(mdp: MDP, row: int) -> list[tuple[int, float]]:
    """A row's successors in order, each once, with its probability; those of 0 are left out."""
    span = slice(int(mdp.row_transition[row]), int(mdp.row_transition[row + 1]))
    successors, where = np.unique(mdp.next_state[span], return_inverse=True)
    chances = np.bincount(where, mdp.row_probabilities(row))
    return [(int(s), float(p)) for s, p in zip(successors, chances, strict=True) if p > 0]


def _name(structure: Structure, row: int) -> str:
    """An action as PRISM and DRN accept it: letters, digits and underscores."""
    action = structure.action(row)
    return "_".join((action.action, *action.arguments)).replace("-", "_")


def _tra(structure: Structure, mdp: MDP) -> Iterator[str]:
    final = int((np.diff(mdp.state_row) == 0).sum())
    merged = [_merged(mdp, row) for row in range(mdp.rows)]
    yield f"{mdp.states} {mdp.rows + final} {sum(map(len, merged)) + final}"
    for state in range(mdp.states):
        rows = _choices(mdp, state)
        if not rows:
            yield f"{state} 0 {state} 1"
        for choice, row in enumerate(rows):
            name = _name(structure, row)
            for successor, chance in merged[row]:
                yield f"{state} {choice} {successor} {chance!r} {name}"


def _sta(structure: Structure, mdp: MDP) -> Iterator[str]:  # noqa: ARG001
    names = [
        "_".join((f.predicate, *f.arguments)).replace("-", "_") for f in structure.problem.facts
    ]
    yield f"({','.join(names)})"
    for number in range(structure.states):
        state: NextState = structure.state(number)
        holds = frozenset() if state is SINK else state
        bits = ("true" if fact in holds else "false" for fact in structure.problem.facts)
        yield f"{number}:({','.join(bits)})"


def _lab(structure: Structure, mdp: MDP) -> Iterator[str]:  # noqa: ARG001
    yield '0="init" 1="deadlock" 2="goal" 3="dead_end"'
    dead_end = structure.dead_end
    for number in range(structure.states):
        labels = [
            str(label)
            for label, applies in (
                (0, number == 0), (2, structure.goal[number]), (3, dead_end[number]),
            )
            if applies
        ]  # fmt: skip
        if labels:
            yield f"{number}: {' '.join(labels)}"


def _srew(structure: Structure, mdp: MDP) -> Iterator[str]:  # noqa: ARG001
    """What a step pays for the state it is taken in; nothing where an episode ends."""
    taken = np.flatnonzero((np.diff(structure.state_row) > 0) & (structure.state_reward != 0))
    yield f"{structure.states} {len(taken)}"
    for number in taken:
        yield f"{number} {float(structure.state_reward[number])!r}"


def _trew(structure: Structure, mdp: MDP) -> Iterator[str]:
    """What a choice pays on average beyond its state's reward, on each of its transitions."""
    entries = []
    for state in range(mdp.states):
        for choice, row in enumerate(_choices(mdp, state)):
            reward = float(mdp.row_reward[row] - structure.state_reward[state])
            if reward:
                entries += [f"{state} {choice} {s} {reward!r}" for s, _ in _merged(mdp, row)]
    final = int((np.diff(mdp.state_row) == 0).sum())
    yield f"{mdp.states} {mdp.rows + final} {len(entries)}"
    yield from entries


def _drn(structure: Structure, mdp: MDP) -> Iterator[str]:
    final = int((np.diff(mdp.state_row) == 0).sum())
    yield "@type: MDP"
    yield "@parameters"
    yield ""
    yield "@reward_models"
    yield "reward"
    yield "@nr_states"
    yield str(mdp.states)
    yield "@nr_choices"
    yield str(mdp.rows + final)
    yield "@model"
    dead_end = structure.dead_end
    for state in range(mdp.states):
        labels = [
            label
            for label, applies in (
                ("init", state == 0), ("goal", structure.goal[state]), ("dead_end", dead_end[state]),
            )
            if applies
        ]  # fmt: skip
        rows = _choices(mdp, state)
        yield " ".join([f"state {state} [0]", *labels])
        if not rows:
            yield "\taction end [0]"
            yield f"\t\t{state} : 1"
        for row in rows:
            yield f"\taction {_name(structure, row)} [{float(mdp.row_reward[row])!r}]"
            for successor, chance in _merged(mdp, row):
                yield f"\t\t{successor} : {chance!r}"


_PRISM: dict[str, Callable[[Structure, MDP], Iterator[str]]] = {
    ".tra": _tra, ".sta": _sta, ".lab": _lab, ".srew": _srew, ".trew": _trew,
}  # fmt: skip
