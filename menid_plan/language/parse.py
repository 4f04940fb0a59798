"""From a text to its syntax tree, with every syntax error that can be found.

A text without errors is parsed in one go. Where that fails, it is read piece by piece, so that an
error in one declaration, rule or row does not hide those in the others (`recover`).
"""

from __future__ import annotations

from contextlib import suppress

from menid_plan.language.grammar import SYNTAX_ERRORS, lexer, parse_tokens
from menid_plan.language.recover import Recovery, SyntaxResult
from menid_plan.source import SourceFile


def parse(source: SourceFile) -> SyntaxResult:
    """Parse a text. Never raises for what the text holds."""
    stream = lexer().split(source)
    if not stream.diagnostics:
        with suppress(*SYNTAX_ERRORS):
            return SyntaxResult(stream, parse_tokens(stream.tokens, "file"), [])
    return Recovery(stream).run()
