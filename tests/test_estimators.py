"""Estimators: golden values, properties of all of them, and their weights against exact fractions."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from menid_plan.learning.estimators import (
    ESTIMATORS,
    MAX_TESTS,
    SAM,
    DecreasingM,
    Empirical,
    Pooled,
    PowerPrior,
    PrecisionGrid,
    RobustMixture,
    SubsetMixture,
    UnknownEstimatorError,
    estimator,
    option_names,
)
from menid_plan.learning.mixtures import DirichletMixture, log_beta, log_gamma

ALL = list(ESTIMATORS)
MIXTURES = ["robust", "sam", "power-prior", "precision-grid", "subsets"]
# Those that may believe in a test only as long as the target's data does not say otherwise.
CONSISTENT = ["empirical", "pooled", "decreasing-m", *MIXTURES]

every = pytest.mark.parametrize("name", ALL)

count = st.one_of(
    st.just(0.0), st.integers(0, 300).map(float), st.floats(0.001, 20.0), st.floats(0.0, 1e9)
)


@st.composite
def tables(draw: st.DrawFn, most_environments: int = 4, most_outcomes: int = 6) -> np.ndarray:
    k = draw(st.integers(2, most_outcomes))
    rows = draw(st.integers(1, most_environments))
    return np.array([[draw(count) for _ in range(k)] for _ in range(rows)])


def modest(table: np.ndarray) -> np.ndarray:
    """The same with counts of at most a thousand, for comparisons to many digits."""
    return np.minimum(table, 1000.0)


# ---------------------------------------------------------------------------------- golden values


@pytest.mark.parametrize(
    ("target", "wanted"), [([0, 0], 0.8), ([1, 2], 0.773585), ([50, 49], 0.532110)]
)
def test_decreasing_m_golden(target: list[float], wanted: float) -> None:
    found = DecreasingM(m=10).posterior([target, [8, 2]]).estimate()
    assert_allclose(found, [wanted, 1 - wanted], atol=5e-7)


def test_decreasing_m_with_a_number_for_each_test() -> None:
    table = np.array([[1.0, 2.0], [8.0, 2.0], [1.0, 9.0]])
    w = np.array([10.0, 4.0]) / 2.0
    weighted = table[0] + w[0] * table[1] + w[1] * table[2]
    found = DecreasingM(m=(10, 4)).posterior(table)
    assert_allclose(found.estimate(), weighted / weighted.sum())
    assert_allclose(found.parameters, [1 + weighted])
    with pytest.raises(ValueError, match="2 values of m were given for 1 tests"):
        DecreasingM(m=(10, 4)).posterior(table[:2])


def test_the_weight_of_m_belongs_to_a_test_and_not_to_its_place_among_those_with_data() -> None:
    table = [[1, 2], [0, 0], [1, 9]]
    alone = DecreasingM(m=4).posterior([[1, 2], [1, 9]]).estimate()
    assert_allclose(DecreasingM(m=(10, 4)).posterior(table).estimate(), alone)


def test_empirical_and_pooled() -> None:
    table = [[1, 3], [6, 0], [1, 1]]
    assert_allclose(Empirical().posterior(table).estimate(), [0.25, 0.75])
    assert_allclose(Empirical().posterior(table).mean(), [2 / 6, 4 / 6])
    assert_allclose(Pooled().posterior(table).estimate(), [8 / 12, 4 / 12])


@every
def test_uniform_without_data(name: str) -> None:
    for rows in (1, 2, 3):
        assert_allclose(estimator(name).posterior(np.zeros((rows, 4))).estimate(), np.full(4, 0.25))


@pytest.mark.parametrize("name", ["empirical", "pooled", "decreasing-m"])
def test_given_probabilities_serve_where_nothing_has_weight(name: str) -> None:
    found = estimator(name).posterior(np.zeros((2, 3)), prior=[0.05, 0.03, 0.02])
    assert_allclose(found.estimate(), [0.5, 0.3, 0.2])


@every
def test_a_prior_is_as_good_as_that_many_observations_in_the_target(name: str) -> None:
    with_prior = estimator(name).posterior([[0, 0], [0, 0]], prior=[6, 2]).mean()
    assert_allclose(with_prior, estimator(name).posterior([[6, 2]]).mean())


# ------------------------------------------------------------------- weights, by exact fractions


def rising(a: Fraction, n: int) -> Fraction:
    return math.prod((a + i for i in range(n)), start=Fraction(1))


def evidence(alpha: list[Fraction], x: list[int]) -> Fraction:
    """B(alpha + x) / B(alpha), without logarithms and without gamma functions."""
    above = math.prod((rising(a, n) for a, n in zip(alpha, x, strict=True)), start=Fraction(1))
    return above / rising(sum(alpha, Fraction(0)), sum(x))


def expected(
    priors: list[tuple[Fraction, list[Fraction]]], x: list[int]
) -> tuple[list[float], list[float]]:
    """The posterior weights and the mean of a mixture of Dirichlets (weight, parameters)."""
    weights = [u * evidence(alpha, x) for u, alpha in priors]
    weights = [w / sum(weights) for w in weights]
    mean = [Fraction(0)] * len(x)
    for w, (_, alpha) in zip(weights, priors, strict=True):
        size = sum(alpha, Fraction(sum(x)))
        mean = [m + w * (a + n) / size for m, a, n in zip(mean, alpha, x, strict=True)]
    return [float(w) for w in weights], [float(m) for m in mean]


def check(found: DirichletMixture, priors: list[tuple[Fraction, list[Fraction]]]) -> None:
    weights, mean = expected(priors, TARGET)
    assert_allclose(found.weights, weights, rtol=1e-10)
    assert_allclose(found.estimate(), mean, rtol=1e-10)


def plus_one(x: list[int], share: Fraction = Fraction(1)) -> list[Fraction]:
    return [1 + share * n for n in x]


TARGET, FIRST, SECOND = [3, 1, 0], [8, 1, 3], [1, 9, 2]
ONE = [Fraction(1)] * 3
HALF = Fraction(1, 2)


def test_robust_weights() -> None:
    found = RobustMixture(weight=0.25, cap=6).posterior([TARGET, FIRST])
    check(found, [(Fraction(3, 4), ONE), (Fraction(1, 4), plus_one(FIRST, HALF))])


def test_robust_weights_with_two_tests() -> None:
    found = RobustMixture(weight=0.5).posterior([TARGET, FIRST, SECOND])
    quarter = Fraction(1, 4)
    check(found, [(HALF, ONE), (quarter, plus_one(FIRST)), (quarter, plus_one(SECOND))])


def test_robust_with_given_probabilities() -> None:
    found = RobustMixture().posterior([TARGET, FIRST], prior=[2, 0, 1])
    base = plus_one([2, 0, 1])
    check(found, [(HALF, base), (HALF, [b + n for b, n in zip(base, FIRST, strict=True)])])


def sam_ratio(test: list[int], shift: Fraction) -> Fraction:
    q = [Fraction(n + 1, sum(test) + 3) for n in test]

    def likelihood(p: list[Fraction]) -> Fraction:
        return math.prod((a**n for a, n in zip(p, TARGET, strict=True)), start=Fraction(1))

    others = []
    for i, sign in product(range(3), (1, -1)):
        edge = Fraction(_EDGE_TEXT)
        moved = min(max(q[i] + sign * shift, edge), 1 - edge)
        rest = [a * (1 - moved) / (1 - q[i]) for a in q]
        others.append(likelihood([*rest[:i], moved, *rest[i + 1 :]]))
    return likelihood(q) / max(others)


_EDGE_TEXT = "0.0001"


def test_sam_weights() -> None:
    found = SAM(shift=0.125, odds=2.0).posterior([TARGET, SECOND])
    ratio = 2 * sam_ratio(SECOND, Fraction(1, 8))
    check(found, [(1 / (1 + ratio), ONE), (ratio / (1 + ratio), plus_one(SECOND))])


def test_sam_for_two_outcomes_is_the_published_ratio() -> None:
    # Yang et al. 2023: u = R / (1 + R), R = p(D | q) / max(p(D | q + d), p(D | q - d)).
    seen, size, q, d = 4, 10, (30 + 1) / (40 + 2), 0.1
    one = q**seen * (1 - q) ** (size - seen)
    others = [(q + s) ** seen * (1 - q - s) ** (size - seen) for s in (d, -d)]
    u = one / (one + max(others))
    prior = [math.log(1 - u), math.log(u)]
    parameters = np.array([[1.0, 1.0], [31.0, 11.0]])
    logs = log_beta(parameters + np.array([seen, size - seen])) - log_beta(parameters) + prior
    found = SAM(shift=d).posterior([[seen, size - seen], [30, 10]])
    assert_allclose(found.weights, np.exp(logs) / np.exp(logs).sum(), rtol=1e-9)


def test_power_prior_weights() -> None:
    found = PowerPrior(points=5).posterior([TARGET, FIRST])
    check(found, [(HALF, plus_one(FIRST, Fraction(i, 4))) for i in range(5)])


def test_power_prior_with_two_tests_has_all_combinations() -> None:
    found = PowerPrior(points=3).posterior([TARGET, FIRST, SECOND])
    shares = [Fraction(i, 2) for i in range(3)]
    priors = [
        (HALF, [1 + a * x + b * y for x, y in zip(FIRST, SECOND, strict=True)])
        for a, b in product(shares, shares)
    ]
    check(found, priors)


def test_precision_grid_weights() -> None:
    found = PrecisionGrid(points=4, highest=1000).posterior([TARGET, FIRST, SECOND])
    priors = [
        (HALF, [Fraction(10**s * (n + 1), sum(test) + 3) for n in test])
        for s in range(4)
        for test in (FIRST, SECOND)
    ]
    check(found, priors)


def test_subset_weights() -> None:
    found = SubsetMixture(weight=0.25).posterior([TARGET, FIRST, SECOND])
    weights, sums = [], []
    for inside in product((0, 1), repeat=2):
        together = [
            n + inside[0] * x + inside[1] * y for n, x, y in zip(TARGET, FIRST, SECOND, strict=True)
        ]
        weight = evidence(ONE, together)
        for member, test in zip(inside, (FIRST, SECOND), strict=True):
            weight *= Fraction(1, 4) if member else Fraction(3, 4) * evidence(ONE, test)
        weights.append(weight)
        sums.append([float(1 + n) for n in together])
    assert_allclose(found.weights, [float(w / sum(weights)) for w in weights], rtol=1e-10)
    assert_allclose(found.parameters, sums)


def test_subsets_keep_the_good_test_and_drop_the_bad_one() -> None:
    found = SubsetMixture().posterior([[16, 4], [80, 20], [20, 80]])
    by_subset = dict(zip(product((0, 1), repeat=2), found.weights.tolist(), strict=True))
    assert max(by_subset, key=by_subset.__getitem__) == (1, 0)
    assert by_subset[0, 1] + by_subset[1, 1] < 1e-4


# -------------------------------------------------------------------------------- properties of all


@every
@settings(max_examples=30, deadline=None)
@given(table=tables(), seed=st.integers(0, 2**32 - 1))
def test_estimates_and_samples_are_distributions(name: str, table: np.ndarray, seed: int) -> None:
    found = estimator(name).posterior(table)
    rng = np.random.default_rng(seed)
    assert math.isclose(found.weights.sum(), 1.0, abs_tol=1e-9)
    for one in (found.estimate(), found.mean(), found.sample(rng), *found.sample(rng, 3)):
        assert one.shape == table.shape[1:]
        assert one.min() >= 0.0
        assert math.isclose(one.sum(), 1.0, abs_tol=1e-9)


@every
@settings(max_examples=20, deadline=None)
@given(table=tables(), data=st.data())
def test_outcomes_have_no_order(name: str, table: np.ndarray, data: st.DataObject) -> None:
    table = modest(table)
    order = data.draw(st.permutations(range(table.shape[1])))
    straight, permuted = (
        estimator(name).posterior(table),
        estimator(name).posterior(table[:, order]),
    )
    assert_allclose(permuted.estimate(), straight.estimate()[order], atol=1e-9)


@every
@settings(max_examples=20, deadline=None)
@given(table=tables(), data=st.data())
def test_tests_without_data_change_nothing(
    name: str, table: np.ndarray, data: st.DataObject
) -> None:
    table = modest(table)
    place = data.draw(st.integers(1, len(table)))
    more = np.insert(table, place, 0.0, axis=0)
    one, other = estimator(name).posterior(table), estimator(name).posterior(more)
    assert_allclose(one.estimate(), other.estimate(), atol=1e-12)
    assert_allclose(one.weights, other.weights, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(table=tables())
def test_m_of_zero_is_the_target_alone(table: np.ndarray) -> None:
    assert_allclose(
        DecreasingM(m=0).posterior(table).estimate(), Empirical().posterior(table).estimate()
    )


@pytest.mark.parametrize("name", CONSISTENT)
@settings(max_examples=15, deadline=None)
@given(table=tables(most_environments=3, most_outcomes=4))
def test_much_target_data_decides(name: str, table: np.ndarray) -> None:
    table = modest(table)
    assume(table[0].sum() > 0)
    truth = table[0] / table[0].sum()
    errors = []
    for size in (1e4, 1e6, 1e9):
        table[0] = truth * size
        errors.append(np.abs(estimator(name).posterior(table).estimate() - truth).max())
    # Nothing but the tests' own counts, at full weight, can be left: less than 3 * 4000 in 10^9.
    assert errors[-1] < 2e-5
    assert errors[-1] <= errors[0] + 1e-12


@every
def test_extreme_counts(name: str) -> None:
    tables = [
        [[1e9, 2e9], [1e9, 1e9]],
        [[1e9, 0], [0, 1e9]],
        [[0.5, 0.25, 0]],
        [[1e-9, 0, 0], [0, 1e-9, 1e9]],
        [[5e-324, 0, 5e-324], [0, 5e-324, 0]],
        np.full((3, 50), 0.1),
        [[0.0]],
    ]
    with np.errstate(all="raise", under="ignore"):  # weights may vanish
        for table in tables:
            found = estimator(name).posterior(table)
            assert math.isclose(found.estimate().sum(), 1.0, abs_tol=1e-9)
            assert np.isfinite(found.sample(np.random.default_rng(0), 5)).all()


@pytest.mark.parametrize("name", MIXTURES)
def test_the_data_contradicts_a_test(name: str) -> None:
    found = estimator(name).posterior([[100, 400], [2700, 300]])
    assert abs(found.estimate()[0] - 0.2) < 0.02


@pytest.mark.parametrize("name", MIXTURES)
def test_a_good_test_helps_while_target_data_is_scarce(name: str) -> None:
    table = [[8, 2], [240, 60]]
    alone = estimator(name).posterior(table[:1])
    helped = estimator(name).posterior(table)
    assert abs(helped.estimate()[0] - 0.8) < abs(alone.mean()[0] - 0.8)
    draws = [each.sample(np.random.default_rng(1), 4000).std(axis=0)[0] for each in (helped, alone)]
    assert draws[0] < draws[1]


@every
def test_samples_have_the_mean(name: str) -> None:
    # Each of the 8 * 3 means is off by more than 5 standard errors with a probability below 6e-7.
    found = estimator(name).posterior([[3, 1, 0], [20, 9, 1], [2, 2, 9]])
    drawn = found.sample(np.random.default_rng(7), 20_000)
    error = drawn.std(axis=0) / math.sqrt(len(drawn))
    assert (np.abs(drawn.mean(axis=0) - found.mean()) < 5 * error).all()


@every
def test_single_draws_have_the_same_mean(name: str) -> None:
    # As above: 24 comparisons at 5 standard errors.
    found = estimator(name).posterior([[3, 1, 0], [20, 9, 1]])
    rng = np.random.default_rng(8)
    drawn = np.array([found.sample(rng) for _ in range(2000)])
    error = drawn.std(axis=0) / math.sqrt(len(drawn))
    assert (np.abs(drawn.mean(axis=0) - found.mean()) < 5 * error).all()


def test_tiny_parameters_can_be_drawn_from() -> None:
    belief = DirichletMixture(np.array([0.5, 0.5]), np.full((2, 2), 1e-4))
    drawn = belief.sample(np.random.default_rng(0), 200)
    assert_allclose(drawn.sum(axis=1), 1.0)


def test_a_seed_fixes_the_draws() -> None:
    found = RobustMixture().posterior([[3, 1], [8, 2]])
    one, two = (found.sample(np.random.default_rng(3), 5) for _ in range(2))
    assert (one == two).all()


def test_log_gamma_is_the_same_for_few_and_many() -> None:
    values = np.geomspace(1e-3, 1e9, 4000)
    assert_allclose(log_gamma(values), np.array([math.lgamma(v) for v in values]), rtol=1e-12)


# ---------------------------------------------------------------------------------------- intervals


@pytest.mark.parametrize("parameters", [[1.0, 1.0], [1.0, 8.0], [92.0, 11.0], [3.0, 5.0, 1.0, 1.0]])
def test_intervals_are_the_shortest_that_hold_enough(parameters: list[float]) -> None:
    belief = DirichletMixture(np.ones(1), np.array([parameters]))
    drawn = np.sort(belief.sample(np.random.default_rng(0), 200_000), axis=0)
    for (low, high), draws in zip(belief.intervals(0.9), drawn.T, strict=True):
        assert np.mean((low <= draws) & (draws <= high)) == pytest.approx(0.9, abs=4e-3)
        widths = draws[180_000:] - draws[:20_000]
        assert high - low == pytest.approx(widths.min(), abs=4e-3)


def test_the_interval_of_a_mixture() -> None:
    belief = DirichletMixture(np.array([0.3, 0.7]), np.array([[80.0, 20.0], [2.0, 9.0]]))
    drawn = belief.sample(np.random.default_rng(0), 200_000)[:, 0]
    low, high = belief.intervals(0.95)[0]
    assert np.mean((low <= drawn) & (drawn <= high)) == pytest.approx(0.95, abs=4e-3)


# ----------------------------------------------------------------------------------- names, mistakes


@every
def test_every_estimator_says_what_it_is(name: str) -> None:
    kind = ESTIMATORS[name]
    assert kind.name == name
    assert kind.promise
    assert any(char.isdigit() for char in kind.reference)
    assert kind.__doc__
    assert estimator(name) == kind()
    assert hash(estimator(name)) == hash(kind())


def test_options_by_name() -> None:
    assert estimator("robust", weight=0.3) == RobustMixture(weight=0.3)
    assert estimator("decreasing-m", m=[1, 2]) == DecreasingM(m=(1.0, 2.0))
    assert option_names(SAM) == ["shift", "odds", "cap"]


def test_unknown_names() -> None:
    with pytest.raises(UnknownEstimatorError, match="did you mean `robust`"):
        estimator("robst")
    with pytest.raises(UnknownEstimatorError, match=r"did you mean `weight`.*weight, cap"):
        estimator("robust", wieght=0.3)
    with pytest.raises(UnknownEstimatorError, match="its options: none"):
        estimator("pooled", zzz=0.3)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("decreasing-m", {"m": -1}),
        ("decreasing-m", {"m": math.nan}),
        ("robust", {"weight": 0.0}),
        ("robust", {"weight": 1.0}),
        ("robust", {"cap": 0.0}),
        ("sam", {"shift": 1.0}),
        ("sam", {"odds": math.inf}),
        ("power-prior", {"points": 1}),
        ("precision-grid", {"points": 0}),
        ("precision-grid", {"highest": -1.0}),
        ("subsets", {"weight": 2.0}),
        ("decreasing-m", {"m": 1e308}),
        ("decreasing-m", {"m": "a"}),
        ("decreasing-m", {"m": [1.0, "a"]}),
        ("robust", {"cap": "a"}),
        ("robust", {"weight": "a"}),
        ("power-prior", {"points": "a"}),
        ("power-prior", {"points": 1e9}),
        ("precision-grid", {"points": 2.5}),
        ("precision-grid", {"highest": 1e300}),
    ],
)
def test_options_that_mean_nothing(name: str, options: dict[str, Any]) -> None:
    (option,) = options
    with pytest.raises(ValueError, match=f"^{option} must"):
        estimator(name, **options)


@every
@pytest.mark.parametrize(
    ("counts", "prior", "message"),
    [
        ([1, 2], None, "a table"),
        (np.zeros((0, 2)), None, "a table"),
        (np.zeros((2, 0)), None, "a table"),
        ([[1, -1]], None, "below 0"),
        ([[1, math.nan]], None, "finite"),
        ([[1, math.inf]], None, "finite"),
        ([[1, 1e300]], None, "beyond"),
        ([[1, 2]], [1], "the prior has the shape"),
        ([[1, 2]], [1, -2], "below 0"),
        ([[1, 2]], [1, math.nan], "finite"),
    ],
)
def test_counts_that_mean_nothing(name: str, counts: object, prior: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        estimator(name).posterior(counts, prior)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["power-prior", "subsets"])
def test_too_many_tests(name: str) -> None:
    table = np.ones((MAX_TESTS + 2, 2))
    with pytest.raises(ValueError, match=f"at most {MAX_TESTS}"):
        estimator(name).posterior(table)
    table[-1] = 0.0  # without data it does not count
    assert_allclose(estimator(name).posterior(table).estimate(), [0.5, 0.5])
