"""The grammar file is LALR(1) without conflicts, and the syntax tree follows it."""

from __future__ import annotations

import re

from lark import Lark

from conftest import EXAMPLE
from menid_plan import resources
from menid_plan.language.builder import Builder

GRAMMAR = (resources.folder("grammar") / "menid.lark").read_text(encoding="utf-8")


def test_strict_lalr_without_conflicts() -> None:
    # strict=True makes every shift/reduce conflict and every collision of terminals an error.
    parser = Lark(GRAMMAR, parser="lalr", lexer="basic", strict=True, start="file")
    assert parser.parse(EXAMPLE).data == "file"


def test_every_rule_of_the_grammar_has_its_builder() -> None:
    rules = set(re.findall(r"^[?!]?([a-z]\w*)\s*:", GRAMMAR, re.MULTILINE))
    aliases = set(re.findall(r"->\s*(\w+)", GRAMMAR))
    # Rules that only ever pass on a child, or that an alias renames, need none.
    passing = set(re.findall(r"^\?([a-z]\w*)\s*:", GRAMMAR, re.MULTILINE)) - {
        "conjunction", "disjunction", "implication",
    }  # fmt: skip
    renamed = set(re.findall(r"^(\w+)\s*:[^\n]*->", GRAMMAR, re.MULTILINE))
    missing = {
        name for name in (rules - passing - renamed) | aliases if not hasattr(Builder(), name)
    }
    assert missing == set()


def test_lark_and_our_lexer_agree() -> None:
    from menid_plan.language.grammar import lexer
    from menid_plan.source import SourceFile

    parser = Lark(GRAMMAR, parser="lalr", lexer="basic", start="file")
    theirs = [(token.type, token.value) for token in parser.lex(EXAMPLE)]
    ours = [(t.type, t.value) for t in lexer().split(SourceFile("", EXAMPLE)).tokens]
    assert ours == theirs
