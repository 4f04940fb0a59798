"""The delta bound: golden values, three methods against each other, coverage; Thompson's table."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from click.testing import Result
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import ROOT
from menid_plan.learning.confidence import (
    METHODS,
    Method,
    delta,
    drawn_errors,
    gap_by_chance,
    mode,
    rank,
    thompson_delta,
    thompson_product,
    thompson_samples,
)
from menid_plan.learning.exact_delta import LEAST_EPSILON, Errors, _of_few, _of_many

GOLDEN = [
    ([5, 5], 0.330688, 0.266206, 0.228750),
    ([90, 10], 0.089534, 0.062688, 0.050848),
    ([30, 12, 5], 0.189669, 0.146777, 0.125946),
    ([3, 1, 0], 0.596837, 0.496593, 0.435683),
    ([100, 100, 100], 0.078683, 0.063300, 0.055456),
]
EPSILONS = (0.01, 0.05, 0.1)

# Few and many outcomes, none seen, all of one, fractional, of very different sizes.
COUNTS: list[list[float]] = [
    [0, 0],
    [9, 0],
    [0.5, 7.25],
    [1e9, 1e6],
    [0, 0, 0],
    [0.5, 0.25, 1.5],
    [5e5, 3, 5e5],
    [1e9, 3e8, 1],
    [3, 2, 1, 0],
    [100, 100, 100, 100],
    [0.3, 0.3, 0.2, 7.5],
    [1e6, 0, 0, 0],
    [1e6, 1e6, 3, 1],
    [0, 0, 0, 0, 0],
    [10, 5, 3, 1, 1],
    [0.5, 0.5, 0.5, 0.2, 10],
    [1e6, 0, 0, 0, 0],
    [1e9, 1e9, 1e9, 1e9, 1e9],
    [*range(12)],
    [2] * 50,
    [0] * 29 + [40],
]
each = pytest.mark.parametrize("counts", COUNTS, ids=lambda c: f"{len(c)}:{sum(c):g}:{max(c):g}")


# -------------------------------------------------------------------------------------- exact bound


@pytest.mark.parametrize(("counts", "at_01", "at_05", "at_10"), GOLDEN)
def test_golden(counts: list[float], at_01: float, at_05: float, at_10: float) -> None:
    for epsilon, wanted in zip(EPSILONS, (at_01, at_05, at_10), strict=True):
        assert delta(counts, epsilon) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("size", [1, 7, 0.5, 1e6])
def test_all_successes(size: float) -> None:
    for counts in ([size, 0], [0, size]):
        assert delta(counts, 0.05) == pytest.approx(1 - 0.05 ** (1 / (size + 1)), rel=1e-12)


def test_nothing_seen() -> None:
    assert delta([0, 0], 0.05) == pytest.approx(0.475)
    # On the triangle what is left of max |p - 1/3| <= 1/3 are three corners of a ninth each:
    # epsilon = 1/3 at d = 1/3.
    assert delta([0, 0, 0], 1 / 3) == pytest.approx(1 / 3, abs=1e-9)


@pytest.mark.parametrize("k", [5, 8, 20])
def test_only_one_of_many_outcomes_seen(k: int) -> None:
    # The error is 1 - p1, Beta(k - 1, 1 + N); its tail is a sum of binomial terms.
    n, d = 30, 0.2
    tail = sum(math.comb(n + k - 1, i) * d**i * (1 - d) ** (n + k - 1 - i) for i in range(k - 1))
    assert delta([n, *[0] * (k - 1)], tail) == pytest.approx(d, rel=1e-6)


@each
def test_exact_against_draws(counts: list[float]) -> None:
    # The share of 40,000 errors above the exact bound; each is off by more than 5 standard errors with
    # a probability below 6e-7.
    samples = 40_000 if len(counts) < 12 else 15_000
    drawn = drawn_errors(np.array(counts, float), samples, np.random.default_rng(1))
    for epsilon in (0.01, 0.1, 0.5):
        bound = delta(counts, epsilon)
        error = math.sqrt(epsilon * (1 - epsilon) / samples)
        assert abs(float((drawn > bound).mean()) - epsilon) < 5 * error


@pytest.mark.parametrize("counts", [[10, 5, 3, 1, 1], [60, 30, 20, 10, 5, 5, 0]])
def test_more_than_four_against_a_million_draws(counts: list[float]) -> None:
    # As above. The bounds that fit so many draws lie within some 1e-4 of each other.
    drawn = drawn_errors(np.array(counts, float), 1_000_000, np.random.default_rng(2))
    share = float((drawn > delta(counts, 0.05)).mean())
    assert abs(share - 0.05) < 5 * math.sqrt(0.05 * 0.95 / len(drawn))


@pytest.mark.parametrize(
    "counts", [[30.0, 12.0, 5.0], [3.0, 1.0, 0.0], [4.0, 3.0, 2.0, 1.0], [0.5, 0.25, 1.5]]
)
def test_two_ways_of_integration_agree(counts: list[float]) -> None:
    errors = Errors.of(np.array(counts), 0.05)
    for d in (0.1, 0.2, 0.35):
        parts = errors._parts(d)
        one, other = _of_few(parts, errors.negligible), _of_many(parts, errors.negligible)
        assert one == pytest.approx(other, abs=2e-5)


@settings(max_examples=40, deadline=None)
@given(
    counts=st.lists(st.one_of(st.just(0.0), st.floats(0.0, 400.0)), min_size=2, max_size=4),
    epsilon=st.floats(0.001, 0.9),
    data=st.data(),
)
def test_exact_bound_properties(counts: list[float], epsilon: float, data: st.DataObject) -> None:
    bound = delta(counts, epsilon)
    order = data.draw(st.permutations(range(len(counts))))
    assert 0.0 < bound < 1.0
    assert delta([counts[i] for i in order], epsilon) == pytest.approx(bound, rel=1e-5)
    assert delta(counts, epsilon / 2) > bound
    assert delta(counts, epsilon, "bonferroni") >= bound * (1 - 1e-6)
    if len(counts) > 2 or min(counts) > 0.0:  # else it is a formula
        errors = Errors.of(np.array(counts), epsilon)
        assert 1.0 - errors.within(bound) == pytest.approx(epsilon, rel=1e-4)


@pytest.mark.parametrize("method", ["exact", "bonferroni"])
@pytest.mark.parametrize(
    "shape", [[0.5, 0.5], [0.9, 0.1], [0.25, 0.5, 0.25], [0.25] * 4, [0.2] * 5]
)
def test_very_large_counts(method: Method, shape: list[float]) -> None:
    # The errors become normal ones: their bounds shrink with the root of the number.
    small, large = (delta([size * q for q in shape], 0.05, method) for size in (1e9, 1e12))
    assert large * math.sqrt(1000) == pytest.approx(small, rel=1e-4)


def test_fractions_next_to_the_end() -> None:
    # Beta(1, 1.25) at .993: its density bends ever more towards 1.
    bound = delta([0, 0.25], 2**-9)
    assert 1 - Errors.of(np.array([0, 0.25]), 2**-9).within(bound) == pytest.approx(2**-9, rel=1e-6)


@pytest.mark.parametrize("counts", [[0, 1, 0, 5e-324], [5e-324, 0, 0], [1e-300, 1], [0, 1e-17, 1]])
def test_counts_next_to_nothing(counts: list[float]) -> None:
    near = np.rint(np.array(counts) / max(counts)) * max(counts)
    assert delta(counts, 0.5) == pytest.approx(delta(near, 0.5), rel=1e-9)


def test_an_outcome_that_is_surely_absent_adds_no_dimension_of_doubt() -> None:
    # With many observations a third outcome that was never seen changes little.
    assert delta([9000, 1000, 0], 0.05) == pytest.approx(delta([9000, 1000], 0.05), rel=0.01)


def test_as_samples_grow_the_bound_falls_as_the_root() -> None:
    bounds = [delta([7 * n, 2 * n, n], 0.05) * math.sqrt(n) for n in (1e3, 1e5, 1e7)]
    assert bounds[1] == pytest.approx(bounds[0], rel=0.01)
    assert bounds[2] == pytest.approx(bounds[1], rel=0.001)


def test_coverage() -> None:
    # Averaged over truths from Dir(1) the bound is exceeded with probability epsilon: of 6000 truths
    # a share that is off by more than 4.5 standard errors has a probability below 7e-6.
    rng = np.random.default_rng(3)
    truths = rng.dirichlet(np.ones(3), 6000)
    seen = rng.multinomial(12, truths)

    @cache
    def bound(counts: tuple[int, ...]) -> float:
        return delta(counts, 0.1)

    bounds = np.array([bound(tuple(sorted(row))) for row in seen.tolist()])
    above = np.abs(seen / 12 - truths).max(axis=1) > bounds
    assert abs(above.mean() - 0.1) < 4.5 * math.sqrt(0.1 * 0.9 / len(truths))


# --------------------------------------------------------------------------- the other two methods


@pytest.mark.parametrize(
    ("epsilon", "samples", "wanted"),
    [(0.05, 10_000, 9500), (0.5, 5, 3), (0.5, 3, 2), (0.99, 10, 1), (0.25, 2, 2), (1e-9, 10, 10)],
)
def test_rank(epsilon: float, samples: int, wanted: int) -> None:
    assert rank(epsilon, samples) == wanted


def test_monte_carlo_is_algorithm_2() -> None:
    counts = np.array([30.0, 12.0, 5.0])
    errors = np.sort(drawn_errors(counts, 1000, np.random.default_rng(5)))
    found = delta(counts, 0.05, "monte-carlo", 1000, np.random.default_rng(5))
    assert found == errors[950 - 1]
    assert delta(counts, 0.05, "monte-carlo") == delta(counts, 0.05, "monte-carlo")


@pytest.mark.parametrize(("counts", "at_01", "at_05", "at_10"), GOLDEN)
def test_monte_carlo_near_exact(
    counts: list[float], at_01: float, at_05: float, at_10: float
) -> None:
    # The rank's error is binomial: the element lies between the exact bounds for epsilon -+ 5 standard
    # errors but for a probability below 6e-7.
    samples = 10_000
    for epsilon in EPSILONS:
        found = delta(counts, epsilon, "monte-carlo", samples, np.random.default_rng(11))
        spread = 5 * math.sqrt(epsilon * (1 - epsilon) / samples)
        low, high = delta(counts, epsilon + spread), delta(counts, max(1e-6, epsilon - spread))
        assert low < found < high


@each
def test_bonferroni_is_an_upper_bound(counts: list[float]) -> None:
    for epsilon in (0.01, 0.3):
        assert delta(counts, epsilon, "bonferroni") >= delta(counts, epsilon) * (1 - 1e-6)


def test_bonferroni_is_exact_where_only_one_side_counts() -> None:
    assert delta([9, 0], 0.05, "bonferroni") == pytest.approx(delta([9, 0], 0.05))
    assert delta([6, 6], 0.05, "bonferroni") == pytest.approx(delta([6, 6], 0.05))


def test_mode() -> None:
    assert mode(np.zeros(4)).tolist() == [0.25] * 4
    assert mode(np.array([3.0, 1.0])).tolist() == [0.75, 0.25]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("counts", "epsilon", "message"),
    [
        ([1.0], 0.1, "two counts"),
        ([[1.0, 2.0]], 0.1, "a row"),
        ([1.0, -2.0], 0.1, "below 0"),
        ([1.0, math.nan], 0.1, "finite"),
        ([1e308, 1e308], 0.1, r"the count 1e\+308 is too large"),
        ([1.0, 1e18], 0.1, r"the count 1e\+18 is too large"),
        ([1e15, 1e15, 1e15], 0.1, r"the count 1e\+15 is too large"),
        ([1.0, 2.0], 0.0, "between 0 and 1"),
        ([1.0, 2.0], 1.0, "between 0 and 1"),
        ([1.0, 2.0], math.nan, "between 0 and 1"),
    ],
)
def test_bad_input(method: Method, counts: list[float], epsilon: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        delta(counts, epsilon, method)


def test_other_bad_input() -> None:
    with pytest.raises(ValueError, match="epsilon of 1e-07 or more"):
        delta([1, 2], LEAST_EPSILON / 2)
    with pytest.raises(ValueError, match="there is no method `guess`; there are: exact"):
        delta([1, 2], 0.1, "guess")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least 1"):
        delta([1, 2], 0.1, "monte-carlo", samples=0)


# ---------------------------------------------------------------------------------- gaps and chance


def test_gaps_by_chance() -> None:
    # One execution in the target, unlike all forty in the test: it is the odd one in a 41st of cases.
    assert gap_by_chance([0, 1], [40, 0]) == pytest.approx(1 / 41, abs=5e-3)
    assert gap_by_chance([5, 5], [50, 50]) == 1.0
    assert gap_by_chance([90, 10], [100, 900]) < 1e-3
    assert gap_by_chance([4e11, 4e11], [4e11, 1e10]) < 1e-3
    assert gap_by_chance([0.3, 0], [10, 2]) == 1.0


def test_chance_keeps_its_promise() -> None:
    rng = np.random.default_rng(1)
    found = np.array(
        [
            gap_by_chance(
                rng.multinomial(30, [0.6, 0.3, 0.1]), rng.multinomial(80, [0.6, 0.3, 0.1]), 500
            )
            for _ in range(400)
        ]
    )
    for p in (0.05, 0.2, 0.5):  # so often at most is it so small; 3 standard errors
        assert np.mean(found <= p) <= p + 3 * np.sqrt(p * (1 - p) / 400)


# ---------------------------------------------------------------------------- Thompson's sample size

# Thompson 1987, table 1: alpha, d^2 n, the worst number of outcomes.
TABLE = [
    (0.5, 0.44129, 4),
    (0.4, 0.50729, 4),
    (0.3, 0.60123, 3),
    (0.2, 0.74739, 3),
    (0.1, 1.00635, 3),
    (0.05, 1.27359, 3),
    (0.025, 1.55963, 2),
    (0.02, 1.65872, 2),
    (0.01, 1.96986, 2),
    (0.005, 2.28515, 2),
    (0.001, 3.02892, 2),
    (0.0005, 3.35304, 2),
    (0.0001, 4.11203, 2),
]


@pytest.mark.parametrize(("alpha", "product", "worst"), TABLE)
def test_thompson_table(alpha: float, product: float, worst: int) -> None:
    found, k = thompson_product(alpha)
    assert found == pytest.approx(product, abs=1e-5)
    assert k == worst
    assert thompson_samples(alpha, 0.05) == math.ceil(product / 0.05**2 - 1e-2)


@given(
    alpha=st.floats(1e-4, 0.99),
    d=st.floats(0.001, 0.5),
    k=st.one_of(st.none(), st.integers(2, 60)),
)
def test_thompson_both_ways(alpha: float, d: float, k: int | None) -> None:
    n = thompson_samples(alpha, d, k)
    assert thompson_delta(alpha, n, k) <= d * (1 + 1e-9)
    if n > 1:
        assert thompson_delta(alpha, n - 1, k) > d * (1 - 1e-9)
    assert thompson_samples(alpha, d) >= n


def test_thompson_with_a_fixed_number_of_outcomes() -> None:
    # z(.0125) = 2.2414 for two outcomes at .05: 2.2414^2 / 4.
    assert thompson_product(0.05, 2)[0] == pytest.approx(2.241403**2 / 4, rel=1e-6)
    assert thompson_samples(0.05, 0.05, 2) < thompson_samples(0.05, 0.05)


def test_thompson_says_about_what_the_exact_bound_says_for_uniform_counts() -> None:
    # Conservative, by the normal approximation with a share of alpha for each outcome.
    for k in (2, 3, 4):
        n = 3000 * k
        assert 1.0 < thompson_delta(0.05, n, k) / delta([3000] * k, 0.05) < 1.2


@pytest.mark.parametrize(
    ("alpha", "d", "k"), [(0, 0.1, 2), (1, 0.1, 2), (0.1, 0, 2), (0.1, 0.1, 1), (0.1, 1e-200, 2)]
)
def test_thompson_bad_input(alpha: float, d: float, k: int) -> None:
    with pytest.raises(ValueError, match=r"must|too small"):
        thompson_samples(alpha, d, k)
    with pytest.raises(ValueError, match="must"):
        thompson_delta(0.1, 0.0)


# ------------------------------------------------------------------------------------- menid delta


def test_command(menid: Callable[..., Result]) -> None:
    assert menid("delta", "90", "10").output == "0.0626885\n"
    assert menid("delta", "30", "12", "5", "--epsilon", "0.1").output == "0.125946\n"


def test_command_json(menid: Callable[..., Result]) -> None:
    found = json.loads(menid("delta", "30", "12", "5", "--json").output)
    assert found.pop("delta") == pytest.approx(0.146777, abs=1e-6)
    assert found == {"counts": [30, 12, 5], "epsilon": 0.05, "method": "exact"}
    options = ["--method", "monte-carlo", "--samples", "500", "--seed", "4", "--json"]
    drawn = [json.loads(menid("delta", "3", "1", *options).output) for _ in range(2)]
    assert drawn[0] == drawn[1]
    assert (drawn[0]["samples"], drawn[0]["seed"]) == (500, 4)
    assert json.loads(menid("delta", "3", "1", "--method", "bonferroni", "--json").output)["delta"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["90", "-1"], "`-1` is no count: it must not be below 0"),
        (["90"], "give at least two counts"),
        ([], "Missing argument"),
        (["nan", "3"], "it must be finite"),
        (["1e400", "3"], "it must be finite"),
        (["1e308", "1e308"], "the count 1e+308 is too large"),
        (["1e18", "5"], "the count 1e+18 is too large"),
        (["99999999999999999999", "1"], "the count 1e+20 is too large"),
        (["1e18", "1", "1", "1", "1", "1"], "the count 1e+18 is too large"),
        (["3", "3", "--seed", "1"], "--seed goes with --method monte-carlo only"),
        (["3", "3", "--samples", "10"], "--samples goes with --method monte-carlo only"),
        (["x", "3"], "`x` is not a number"),
        (["3", "3", "--epsilon", "1"], "1 does not lie between 0 and 1"),
        (["3", "3", "--epsilon", "nan"], "nan does not lie between 0 and 1"),
        (["3", "3", "--epsilon", "1e-9"], "needs an epsilon of 1e-07 or more"),
        (["3", "3", "--samples", "0"], "'--samples'"),
        (["3", "3", "--method", "guess"], "'guess' is not one of"),
        (["3", "3", "--sample"], "--sample"),
        (["3", "3", "--nothing"], "--nothing"),
    ],
)
def test_command_bad_input(
    menid: Callable[..., Result], arguments: list[str], message: str
) -> None:
    result = menid("delta", *arguments)
    assert result.exit_code == 2
    assert message in result.output


def test_the_command_starts_without_scipy() -> None:
    program = (
        "import sys; from click.testing import CliRunner; from menid_plan.cli.main import main;"
        "result = CliRunner().invoke(main, ['delta', '90', '10']);"
        "assert result.exit_code == 0, result.output;"
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    assert "numpy" in loaded
    assert {"scipy", "numba", "llvmlite", "rich", "matplotlib"} & set(loaded) == set()
