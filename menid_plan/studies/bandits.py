"""Random actions with a simulator that may lie: where to act, on the smallest problem there is.

Each of K actions succeeds with a probability of its own, in the target and in the test. Nothing is
executed: what would come of the n-th execution of an action is drawn beforehand, and is the same for
all who learn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from menid_plan.allocation.belief import Belief
from menid_plan.allocation.rule import Rule, View
from menid_plan.environments.seeds import seed_of
from menid_plan.learning.confidence import delta
from menid_plan.learning.mixtures import Floats
from menid_plan.mdp.model import Bools
from menid_plan.studies.pieces import Row

TARGET, TEST, HOUR = 30.0, 0.4, 3600.0  # seconds: an execution, a test, a run
MINUTES: Floats = 60.0 * np.arange(1.0, 61.0)
# Of the paper's learner: T, m, and the threshold of delta with its epsilon.
_TIME, _M, _DELTA, _EPSILON = 20.0, 10.0, 0.05, 0.05
# Of 400 tests the delta is below .05 for certain.
_KNOWN = 400
_DRAWS = 48  # to see what there is to hope for

Lie = Callable[[Floats, np.random.Generator], Floats]


def population(number: int, rng: np.random.Generator) -> Floats:
    """Success probabilities of actions: most succeed seldom, some now and then, a few mostly."""
    kind = rng.choice(3, number, p=[0.6, 0.25, 0.15])
    kinds = [
        rng.beta(0.5, 10.0, number),
        rng.uniform(0.2, 0.8, number),
        rng.beta(18.0, 1.5, number),
    ]
    found: Floats = np.array(kinds)[kind, np.arange(number)]
    return found


def _junk(p: Floats, rng: np.random.Generator) -> Floats:
    return np.where(rng.random(len(p)) < 0.2, rng.random(len(p)), p)


SIMULATORS: Mapping[str, Lie] = {
    "perfect": lambda p, _: p,
    "noise": lambda p, rng: np.clip(p + rng.normal(0.0, 0.2, len(p)), 0.0, 1.0),
    "junk": _junk,
    "permuted": lambda p, rng: rng.permutation(p),
    "high": lambda p, _: np.full(len(p), 0.95),
    "low": lambda p, _: np.full(len(p), 0.05),
    "inverted": lambda p, _: 1.0 - p,
}
"""What the simulator has to do with the target: the first three are honest, the others lie.

Normal noise has a standard deviation of .2; of junk, a fifth of all actions is anything.
"""

PAPER, TESTING, ALONE, GAIN = "T = 0", "T = 20", "no simulator", "gain"


@dataclass(frozen=True, slots=True)
class Bandit:
    """One hour with K actions, for all simulators, penalties and learners; ``number`` is the seed's.

    ``T = 0`` and ``T = 20`` are the paper's learner: Thompson sampling, decreasing-m with m = 10.
    ``gain`` is that of `menid learn --allocate gain`, and ``no simulator`` the same rule without one.
    """

    actions: int
    number: int
    seed: int
    penalties: tuple[float, ...]

    @property
    def name(self) -> str:
        """Tells it from all others."""
        penalties = ",".join(f"{penalty:g}" for penalty in self.penalties)
        return f"bandit: {self.actions} actions, {self.number}, penalties {penalties}"

    def run(self) -> Row:
        """Of each learner successes and failures by each minute, and the number of tests.

        By simulator, penalty and learner; ``oracle`` has the highest success probability.
        """
        rng = np.random.default_rng(seed_of(self.seed, "bandit", self.actions, self.number))
        p = population(self.actions, rng)
        ends = rng.random((self.actions, int(HOUR / TARGET) + 1)) < p[:, None]
        chances = {name: lie(p, rng) for name, lie in SIMULATORS.items()}
        # Of gain's tests a quarter of the clock, and five minutes; the last may be over that.
        lots = rng.random((self.actions, int((300.0 + HOUR / 4.0) / TEST) + 100))
        found: Row = {"oracle": float(p.max())}
        none = np.zeros((self.actions, 0), np.bool_)
        paper = _paper(ends, none, self._rng("paper"))
        alone = {c: _weighed(ends, none, c, self._rng("gain")) for c in self.penalties}
        for name, q in chances.items():
            tests = lots < q[:, None]
            testing = _paper(ends, tests[:, :_KNOWN], self._rng("paper"))
            found[name] = {
                f"{c:g}": {
                    PAPER: paper, TESTING: testing, ALONE: alone[c],
                    GAIN: _weighed(ends, tests, c, self._rng("gain")),
                }
                for c in self.penalties
            }  # fmt: skip
        return found

    def _rng(self, what: str) -> np.random.Generator:
        return np.random.default_rng(seed_of(self.seed, what, self.actions, self.number))


def _told(times: list[float], won: list[bool], tests: int) -> Row:
    """Successes and failures by each minute: what ends after it does not count."""
    seen = np.searchsorted(np.array(times), MINUTES, side="right")
    successes = np.concatenate(([0], np.cumsum(won)))[seen]
    return {
        "successes": successes.tolist(), "failures": (seen - successes).tolist(), "tests": tests,
    }  # fmt: skip


def _paper(ends: Bools, tests: Bools, rng: np.random.Generator) -> Row:
    """Algorithm 1 with Thompson sampling; no tests at all if ``tests`` (bool[K, n]) has none."""
    number, size = len(ends), round(_TIME / TEST)
    seen = np.zeros((number, 2, 2))  # by action: target and test, successes and failures
    marked: set[int] = set()
    clock, tested = 0.0, 0
    times: list[float] = []
    won: list[bool] = []
    while clock < HOUR:
        weight = _M / np.sqrt(1.0 + seen[:, 0].sum(axis=1))
        up, down = (seen[:, 0] + weight[:, None] * seen[:, 1] + 1.0).T
        a = int(rng.beta(up, down).argmax())
        done = int(seen[a, 1].sum())
        unsure = done < tests.shape[1] and _bound(*seen[a, 1].astype(int).tolist()) > _DELTA
        if unsure and a not in marked:
            marked.add(a)
            good = int(tests[a, done : done + size].sum())
            seen[a, 1] += good, size - good
            clock += _TIME
            tested += size
        else:
            marked.discard(a)
            good = bool(ends[a, int(seen[a, 0].sum())])
            seen[a, 0, 0 if good else 1] += 1
            clock += TARGET
            times.append(clock)
            won.append(good)
    return _told(times, won, tested)


@cache
def _bound(successes: int, failures: int) -> float:
    return delta([successes, failures], _EPSILON)


def _weighed(ends: Bools, tests: Bools, penalty: float, rng: np.random.Generator) -> Row:
    """The rule of `menid_plan.allocation`, with a test or without."""
    number, simulators = len(ends), 1 if tests.shape[1] else 0
    belief = Belief([2] * number, [0] * number, simulators)
    rule = Rule(belief, rng.random(number))
    payoffs = np.tile([1.0, -penalty], (number, 1))
    seconds, test_seconds = np.full(number, TARGET), np.full((simulators, number), TEST)
    clock = tested = 0.0
    times: list[float] = []
    won: list[bool] = []
    while clock < HOUR:
        if belief.learn():
            rule.forget()
        mean = (belief.mean() * payoffs).sum(axis=1)
        hoped = 0.0
        if simulators:
            drawn = (belief.sample(rng, _DRAWS) * payoffs).sum(axis=2)
            hoped = float(drawn.max(axis=1).mean()) / TARGET
        view = View(
            np.arange(number), payoffs, _others(mean), np.full(number, 1.0 / TARGET), seconds,
            test_seconds, float(mean.max()) / TARGET, hoped, 1.0 / TARGET,
        )  # fmt: skip
        found = rule.tests(view, HOUR - clock, clock, tested)
        if found is not None:
            done = int(belief.counts[found.row, 1].sum())
            good = int(tests[found.row, done : done + found.number].sum())
            belief.add(found.row, 1, np.array([good, found.number - good], float))
            clock += found.number * TEST
            tested += found.number * TEST
            continue
        a = int((mean + rule.bonuses(view, HOUR - clock)).argmax())
        ended = bool(ends[a, int(belief.counts[a, 0].sum())])
        belief.add(a, 0, np.array([ended, not ended], float))
        clock += TARGET
        times.append(clock)
        won.append(ended)
    return _told(times, won, round(tested / TEST))


def _others(values: Floats) -> Floats:
    """The best of all others, for each (float64[n])."""
    order: NDArray[np.int64] = np.argsort(values)
    found = np.full(len(values), values[order[-1]])
    found[order[-1]] = values[order[-2]] if len(values) > 1 else -np.inf
    return found
