"""No input crashes the reader, and none makes it run away."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import EXAMPLE
from menid_plan.language.check import check
from menid_plan.language.files import MAX_BYTES
from menid_plan.language.grammar import lexer
from menid_plan.language.parse import parse
from menid_plan.source import SourceFile, render

Menid = Callable[..., Result]

HEAD = b"domain d predicate p predicate q(object) "
N = 100_000

INPUTS = {
    "empty": b"",
    "blank": b" \n\t\r\n",
    "invalid UTF-8": HEAD + b"\xff\xfe\x80",
    "truncated UTF-8": HEAD + "ä".encode()[:1],
    "UTF-16": EXAMPLE.encode("utf-16"),
    "NUL bytes": b"\0" * 1000,
    "NUL in a name": b"domain a\0b",
    "control characters": bytes(range(32)) * 10,
    "nested parentheses": HEAD + b"derived r = " + b"(" * N + b"p" + b")" * N,
    "unclosed parentheses": HEAD + b"derived r = " + b"(" * N,
    "closing parentheses": HEAD + b")" * N,
    "braces": HEAD + b"action a " + b"{" * N,
    "closing braces": HEAD + b"}" * N,
    "many nots": HEAD + b"derived r = " + b"not " * N + b"p",
    "many implications": HEAD + b"derived r = " + b"p implies " * N + b"p",
    "many signs": HEAD + b"param r = " + b"- " * N + b"1",
    "a long sum": HEAD + b"param r = 1" + b" + 1" * N,
    "nested quantifiers": HEAD
    + b"derived r = "
    + b"".join(b"exists x%d: object (" % i for i in range(2000))
    + b"p"
    + b")" * 2000,
    "a long name": b"domain " + b"a" * N,
    "many hyphens": b"domain " + b"a-" * N,
    "a long number": HEAD + b"param r = " + b"9" * N,
    "a long fraction": HEAD + b"param r = 0." + b"9" * N,
    "a huge exponent": HEAD + b"param r = 1e" + b"9" * 1000,
    "a long line": b"domain d # " + b"x" * N + b"\npredicate p predicate p",
    "a huge range": b"domain d constant n1..n99999999999: object",
    "a huge count": HEAD + b"derived r = count x: object (q(x)) >= " + b"9" * 5000,
    "a huge horizon": HEAD + b"problem t for d horizon " + b"9" * 5000,
    "only keywords": b"rule outcomes the when action per " * 2000,
    "only names": b"name " * 50_000,
    "only colons": b"a:" * 50_000,
    "many unclosed rows": HEAD + b"action a { rule r { outcomes { " + b"a: b c " * 10_000,
    "many unknown names": b"domain d\n"
    + b"".join(b"derived d%d = u%d\n" % (i, i) for i in range(5000)),
    "many duplicates": b"domain d " + b"predicate p " * 20_000,
    "comment without an end": HEAD + b"#" * N,
}


@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("command", ["check", "fmt"])
def test_hostile_input_gets_a_message(
    name: str, command: str, menid: Menid, tmp_path: Path
) -> None:
    path = tmp_path / "hostile.menid"
    path.write_bytes(INPUTS[name])
    result = menid(command, "hostile.menid")
    fine = {"empty", "blank", "comment without an end", "a long fraction"}
    assert result.exit_code == (0 if name in fine else 3), result.output[:500]
    assert "Traceback" not in result.output
    if name not in fine:
        assert "error[M" in result.output
        assert path.read_bytes() == INPUTS[name]
    # A message stays a message, whatever the text is like.
    assert all(len(line) < 1000 for line in result.output.splitlines() if "error[" in line)


def test_a_file_of_50_megabytes_is_refused(menid: Menid, tmp_path: Path) -> None:
    path = tmp_path / "big.menid"
    with path.open("wb") as file:
        file.write(b"domain d\n")
        file.truncate(50_000_000)
    for command in ("check", "fmt", "show"):
        result = menid(command, "big.menid")
        assert result.exit_code == 6
        assert "larger than the limit of 4 MiB" in result.output
    assert path.stat().st_size == 50_000_000
    assert menid("check", "-", input=b" " * (MAX_BYTES + 1)).exit_code == 6


@pytest.mark.parametrize("newline", ["\r\n", "\r", "\n"])
@pytest.mark.parametrize("mark", ["\ufeff", ""])
def test_line_ends_and_byte_order_marks_do_not_matter(
    newline: str, mark: str, menid: Menid, tmp_path: Path
) -> None:
    text = EXAMPLE.replace("predicate loose(pcb)", "predicate loose(pbc)")
    (tmp_path / "a.menid").write_bytes((mark + text.replace("\n", newline)).encode())
    result = menid("check", "--json", "a.menid")
    found = json.loads(result.output)["diagnostics"]
    line = text.splitlines().index("predicate loose(pbc)") + 1
    assert [(d["line"], d["column"], d["code"]) for d in found] == [(line, 17, "M202")]


def test_ten_thousand_predicates(menid: Menid, tmp_path: Path) -> None:
    lines = ["domain d"]
    lines += [f"predicate p{i}(object)" for i in range(10_000)]
    # A chain as long as the file, and one error at its end.
    lines += [f"derived d{i} = d{i + 1}" for i in range(2_000)]
    lines += ["derived d2000 = exists x: object (p9999(x) and p10000(x))"]
    (tmp_path / "a.menid").write_text("\n".join(lines))
    result = menid("check", "a.menid")
    assert result.exit_code == 3
    assert "unknown predicate `p10000`; did you mean `p1000`?" in result.output
    assert (
        menid("check", "-", input="\n".join(lines[:-1]) + "\nderived d2000 = true").exit_code == 0
    )


WORDS = [
    *sorted(lexer().reserved_words),
    "(", ")", "{", "}", ",", ":", "=", "!=", "<", "<=", "|", "..", "+", "-", "*", "/",
    "a", "b", "p", "d", "noise", "target", "0.5", "1", "a:", "p(a)", "# c\n", "\n",
]  # fmt: skip


def unharmed(text: str) -> None:
    """Whatever the text, the reader ends with diagnostics whose spans lie inside it."""
    result = check(SourceFile("x", text))
    for diagnostic in result.diagnostics:
        assert 0 <= diagnostic.span.start <= diagnostic.span.end <= len(text) + 1
        assert render(diagnostic)
    if result.domain is None and result.problem is None and text.strip():
        assert result.diagnostics


@settings(deadline=None, max_examples=300)
@given(st.lists(st.sampled_from(WORDS), max_size=60))
def test_random_tokens(words: list[str]) -> None:
    unharmed(" ".join(words))


@settings(deadline=None, max_examples=200)
@given(st.text(max_size=200))
def test_random_text(text: str) -> None:
    unharmed(text.replace("\r", "\n"))


@settings(deadline=None, max_examples=300)
@given(
    st.integers(0, len(EXAMPLE)),
    st.integers(0, 40),
    st.lists(st.sampled_from(WORDS), max_size=4).map(" ".join),
)
def test_a_good_text_with_a_piece_replaced(start: int, length: int, piece: str) -> None:
    unharmed(EXAMPLE[:start] + piece + EXAMPLE[start + length :])


@settings(deadline=None, max_examples=200)
@given(st.binary(max_size=300))
def test_random_bytes(data: bytes) -> None:
    from menid_plan.language.files import decode

    source, bad = decode(data, "x")
    for diagnostic in bad:
        assert render(diagnostic)
    if not bad:
        unharmed(source.text)


def test_every_syntax_error_is_reported_though_others_precede_it() -> None:
    broken = EXAMPLE.replace("param win = 1", "param win = ").replace(
        "predicate loose(pcb)", "predicate loose(pcb"
    )
    broken = broken.replace("goal done()", "goal and done()").replace("horizon 40", "horizon forty")
    lines = [d.span.line for d in parse(SourceFile("", broken)).diagnostics]
    assert len(lines) == 4
    assert lines == sorted(lines)


@pytest.mark.parametrize(
    "text",
    [
        "domain d " + " ".join(f"constant a{i}x1..a{i}x100000: object" for i in range(400)),
        "domain d action a { rule r " + "{}" * 100_000,
        "$ " * 200_000,
        "domain d param " + "x" * 200_000 + " = 1 " + "param a = b " * 2000,
        "domain d " + "predicate p " * 30_000,
    ],
    ids=["ranges", "braces", "signs", "a long name", "duplicates"],
)
def test_what_once_ran_away(text: str, menid: Menid) -> None:
    result = menid("check", "-", input=text)
    assert result.exit_code == 3
    assert len(result.output) < 1_000_000
