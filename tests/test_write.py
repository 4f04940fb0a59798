"""What is written is read back equal, and the layout is a fixed point."""

from __future__ import annotations

from hypothesis import HealthCheck, given, settings

import menid_plan
from menid_plan.language.layout import layout
from menid_plan.model.domain import Domain, Problem
from strategies import domains_with_problems

slow = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@slow
@given(domains_with_problems())
def test_written_and_read_back_equal(pair: tuple[Domain, Problem]) -> None:
    domain, problem = pair
    text = menid_plan.write(domain)
    assert menid_plan.parse(text).domain == domain
    task = menid_plan.write(problem)
    assert menid_plan.parse(task, domain).problem == problem
    both = menid_plan.parse(text + "\n" + task)
    assert (both.domain, both.problem) == (domain, problem)


@slow
@given(domains_with_problems())
def test_layout_of_what_is_written_is_a_fixed_point(pair: tuple[Domain, Problem]) -> None:
    for value in pair:
        text = menid_plan.write(value)
        assert layout(text) == text
