"""Colours for ```menid blocks: a Pygments lexer with the reserved words of the grammar."""

from __future__ import annotations

from typing import Any, ClassVar

from pygments.lexer import RegexLexer, words
from pygments.token import Comment, Keyword, Name, Number, Operator, Punctuation, Text
from sphinx.application import Sphinx

from menid_plan.language.grammar import lexer

_OPERATORS = {"and", "or", "not", "implies", "exists", "forall", "count", "true", "false", "object"}


class MenidLexer(RegexLexer):
    """MENID, right or wrong: a character that means nothing is plain text."""

    name = "MENID"
    aliases: ClassVar[list[str]] = ["menid"]
    filenames: ClassVar[list[str]] = ["*.menid"]

    tokens: ClassVar[dict[str, list[Any]]] = {
        "root": [
            (r"#.*", Comment.Single),
            (r"[A-Za-z_][A-Za-z0-9_]*(?:-[A-Za-z0-9_]+)*(?=\s*:)", Name.Label),
            (
                words(
                    sorted(lexer().reserved_words - _OPERATORS),
                    prefix=r"(?<![\w-])",
                    suffix=r"(?![\w-])",
                ),
                Keyword,
            ),
            (
                words(sorted(_OPERATORS), prefix=r"(?<![\w-])", suffix=r"(?![\w-])"),
                Operator.Word,
            ),
            (r"[A-Za-z_][A-Za-z0-9_]*(?:-[A-Za-z0-9_]+)*", Name),
            (r"[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?", Number),
            (r"[{}(),:|]|\.\.", Punctuation),
            (r"[=!<>]=?|[-+*/]", Operator),
            (r"\s+|.", Text),
        ]
    }


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the lexer known to Sphinx."""
    app.add_lexer("menid", MenidLexer)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
