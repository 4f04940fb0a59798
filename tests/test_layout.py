"""The layout changes white space alone, keeps every comment where it stood, and is a fixed point."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import EXAMPLE
from menid_plan.language.check import check
from menid_plan.language.grammar import lexer
from menid_plan.language.layout import layout
from menid_plan.source import SourceFile


def tokens(text: str) -> list[str]:
    return [token.value for token in lexer().split(SourceFile("", text)).tokens]


def comments(text: str) -> list[tuple[str, int, bool]]:
    found = lexer().split(SourceFile("", text)).comments
    return [(comment.text, comment.before, comment.own_line) for comment in found]


ENDS = [token.end for token in lexer().split(SourceFile("", EXAMPLE)).tokens]


def test_the_example_is_a_fixed_point() -> None:
    assert layout(EXAMPLE) == EXAMPLE


@pytest.mark.parametrize("comment", [" # here\n", "\n# here\n", "\n\n# here\n\n", "\n# a\n\n# b\n"])
def test_a_comment_between_any_two_tokens_stays(comment: str) -> None:
    for end in [0, *ENDS]:
        text = EXAMPLE[:end] + comment + EXAMPLE[end:]
        formatted = layout(text)
        assert tokens(formatted) == tokens(text)
        assert comments(formatted) == comments(text)
        assert layout(formatted) == formatted
        # What a comment documents stays the same too.
        before, after = check(SourceFile("", text)), check(SourceFile("", formatted))
        assert before.domain == after.domain
        assert before.problem == after.problem
        assert before.domain is not None


@pytest.mark.parametrize("separator", [" # {}\n", "\n# {}\n"])
def test_comments_between_all_tokens_stay_in_order(separator: str) -> None:
    words = tokens(EXAMPLE)
    text = "".join(word + separator.format(i) for i, word in enumerate(words))
    formatted = layout(text)
    assert tokens(formatted) == words
    assert [text for text, _, _ in comments(formatted)] == [f"# {i}" for i in range(len(words))]
    assert layout(formatted) == formatted


@settings(deadline=None, max_examples=150)
@given(
    st.lists(
        st.sampled_from([" ", "\n", "\n\n", "\t", " # x\n", "\n# y\n"]),
        min_size=len(ENDS),
        max_size=len(ENDS),
    )
)
def test_any_white_space_gives_the_same_tokens_and_a_fixed_point(gaps: list[str]) -> None:
    text = "".join(word + gap for word, gap in zip(tokens(EXAMPLE), gaps, strict=True))
    formatted = layout(text)
    assert tokens(formatted) == tokens(EXAMPLE)
    assert comments(formatted) == comments(text)
    assert layout(formatted) == formatted


def test_tables_are_aligned_and_long_lines_broken() -> None:
    text = (
        "domain d predicate p(object) param q = 0.5 action a(x: object) { rule r {"
        "outcomes{long-name: (q)\nnot p(x), if p(x) and p(x) { p(x), not p(x) }, p(x), p(x), p(x),"
        " p(x) reward q b: 0.25 nothing reward -1 c: 1/4 p(x) } observed target { b: 7 c: 1234 } } }"
    )
    assert layout(text).splitlines()[7:16] == [
        "    outcomes {",
        "      long-name: (q)   not p(x), if p(x) and p(x) { p(x), not p(x) }, p(x), p(x), p(x),",
        "          p(x) reward q",
        "      b:         0.25  nothing  reward -1",
        "      c:         1/4   p(x)",
        "    }",
        "    observed target {",
        "      b:    7",
        "      c: 1234",
    ]
