"""Reads a text that does not parse as a whole: piece by piece, each with its own errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from menid_plan.language import syntax
from menid_plan.language.grammar import SYNTAX_ERRORS, lexer, parse_tokens
from menid_plan.language.hints import similar
from menid_plan.language.pieces import (
    DECLARATION_STARTS,
    DOMAIN_STARTS,
    HEADERS,
    PROBLEM_STARTS,
    balanced,
    closed,
    declarations,
    is_open,
    rows,
    sign,
    without_context,
)
from menid_plan.language.syntax import Token
from menid_plan.language.syntax_errors import explain
from menid_plan.language.tokens import BAD, TokenStream, nesting_diagnostic
from menid_plan.source import Diagnostic, Span

# Past this many syntax errors the rest of a text is not looked at: it is no MENID.
MAX_SYNTAX_ERRORS = 100

_INSTEAD = {
    "OBJECT": "a domain declares the objects that every problem has as `constant`",
    "PREDICATE": "predicates are declared in the domain",
    "CONSTANT": "a problem declares its things as `object`",
    "REWARD": "state rewards are declared in the domain; a problem has `goal FORMULA reward EXPR`",
}


@dataclass(slots=True)
class SyntaxResult:
    """A text's tree as far as it could be read.

    ``lost_names`` are the names in the pieces that could not be read: they may be declared there, so
    that nothing should be said against their use elsewhere.
    """

    stream: TokenStream
    file: syntax.File
    diagnostics: list[Diagnostic]
    lost_names: set[str] = field(default_factory=set)


class Recovery:
    """Reads the declarations of a text one by one."""

    def __init__(self, stream: TokenStream) -> None:
        self.stream = stream
        self.source = stream.source
        self.diagnostics = list(stream.diagnostics)
        self.lost: set[str] = set()
        self.domain: syntax.Domain | None = None
        self.problem: syntax.Problem | None = None
        self._columns = self._indentation()
        self._homeless = False

    def run(self) -> SyntaxResult:
        """The tree of what can be read, and every error."""
        for piece in declarations(self.stream.tokens, self._strays()):
            if self._is_full:
                self._error(
                    "M106", f"more than {MAX_SYNTAX_ERRORS} syntax errors: the rest is not read",
                    piece[0],
                )  # fmt: skip
                self.lost.update(t.value for t in self.stream.tokens if t.type.startswith("NAME"))
                break
            if piece[0].type in HEADERS:
                self._header(piece, piece[0].value)
            elif piece[0].type in DECLARATION_STARTS:
                self._declaration(piece)
            else:
                self._stray(piece)
        tree = syntax.File(self.domain, self.problem)
        return SyntaxResult(self.stream, tree, self.diagnostics, self.lost)

    @property
    def _is_full(self) -> bool:
        return len(self.diagnostics) - len(self.stream.diagnostics) >= MAX_SYNTAX_ERRORS

    def _indentation(self) -> dict[int, int]:
        """By token: the indentation of its line; for the first of a line, -1 less that."""
        columns: dict[int, int] = {}
        line, indent = 0, 0
        for token in self.stream.tokens:
            at, column = self.source.position(token.start)
            if at != line:
                line, indent = at, column - 1
                columns[token.index] = -1 - indent
            else:
                columns[token.index] = indent
        return columns

    def _strays(self) -> frozenset[int]:
        """Names that start a line and look like a word that starts a declaration."""
        words = [lexer().text_of(terminal) for terminal in DECLARATION_STARTS]
        known: dict[str, bool] = {}
        found = set()
        for token in self.stream.tokens:
            if token.type == "NAME" and self._columns[token.index] < 0 and len(known) < 2000:
                if token.value not in known:
                    known[token.value] = similar(token.value, words, 0.75) is not None
                if known[token.value]:
                    found.add(token.index)
        return frozenset(found)

    # ----------------------------------------------------------------------------- declarations

    def _stray(self, piece: list[Token]) -> None:
        """A piece that starts with no word that starts a declaration."""
        seen = self.problem or self.domain
        self._try(piece, "declaration" if seen else "file")
        meant = similar(piece[0].value, ["domain", "problem"], 0.75)
        if meant is not None and not (self.problem or (meant == "domain" and self.domain)):
            self._header(piece, meant)

    def _header(self, piece: list[Token], kind: str) -> None:
        taken = self.problem or (self.domain if kind == "domain" else None)
        if taken is not None:
            message = f"a second `{kind}` in one file"
            if kind == "domain" and self.domain is None:
                message = "the domain comes after the problem"
            self._error("M103", message, piece[0], "a file holds a domain, then a problem")
            return
        node: Any = self._try(piece, kind) if piece[0].type in HEADERS else None
        if node is None:
            # Go on as if the header were right, so that what follows is read.
            name = next((t for t in piece[1:] if t.type.startswith("NAME")), piece[0])
            lost = Token("NAME", "", name.start, name.end, name.index)
            node = (
                syntax.Domain(piece[0], lost, [])
                if kind == "domain"
                else syntax.Problem(piece[0], lost, lost, [])
            )
        if kind == "domain":
            self.domain = node
        else:
            self.problem = node

    def _declaration(self, piece: list[Token]) -> None:
        keyword = piece[0]
        here: syntax.Domain | syntax.Problem | None = self.problem or self.domain
        node = self._action(piece) if keyword.type == "ACTION" else self._try(piece, "declaration")
        if here is None:
            if not self._homeless:
                self._error(
                    "M103", f"`{keyword.value}` stands before any `domain` or `problem`", keyword,
                    "a file starts with `domain NAME` or `problem NAME for DOMAIN`",
                )  # fmt: skip
            self._homeless = True
            return
        allowed = PROBLEM_STARTS if self.problem else DOMAIN_STARTS
        if keyword.type not in allowed:
            place = "problem" if self.problem else "domain"
            self._error(
                "M103", f"`{keyword.value}` does not belong in a {place}", keyword,
                _INSTEAD.get(keyword.type),
            )  # fmt: skip
        elif node is not None:
            items: list[Any] = here.items
            items.append(node)

    # -------------------------------------------------------------------------- actions and rules

    def _action(self, piece: list[Token]) -> syntax.Action | None:
        node: syntax.Action | None
        node, error = self._quietly(piece, "action")
        if error is None:
            return node
        if is_open(piece):
            piece, open_braces = closed(piece, self._columns)
            for brace in open_braces:
                self._error(
                    "M105", "`{` is never closed", brace,
                    "each action, rule, table and block ends with a `}` of its own",
                )  # fmt: skip
            node, error = self._quietly(piece, "action")
            if error is None:
                return node
        starts = [
            i
            for i, token in enumerate(piece)
            if token.type == "RULE" and i > 1 and piece[i - 1].type != "RULE"
        ]
        if not starts:
            self._fail(piece, error)
            return None
        before = len(self.diagnostics)
        head, close = piece[: starts[0]], sign("RBRACE", "}", piece[-1])
        rules = []
        for start, end in zip(starts, [*starts[1:], len(piece)], strict=True):
            rule = self._rule(balanced(piece[start:end]))
            if rule is not None:
                rules.append(rule)
        # The head is right if it parses before a rule that is.
        node = self._try([*head, *_stand_in(head[-1]), close], "action")
        if node is None:  # go on without parameters; their names are lost, and not reported
            bare = [*head[:2], sign("LBRACE", "{", head[-1])]
            node, _ = self._quietly([*bare, *_stand_in(head[-1]), close], "action")
        if len(self.diagnostics) == before:  # all parts are right, but not together
            self._fail(piece, error)
        if node is not None:
            node.rules = rules
        return node

    def _rule(self, piece: list[Token]) -> syntax.Rule | None:
        """A rule, without its rows or conditions that are wrong; then it is not ``whole``."""
        node: syntax.Rule | None
        node, error = self._quietly(piece, "rule")
        if error is None:
            return node
        before = len(self.diagnostics)
        good = []
        for is_row, part in rows(piece):
            if is_row and self._try(part, is_row) is None:
                continue
            good.extend(part)
        node, rest = self._quietly(good, "rule")
        if rest is not None:
            self._fail(good, rest)
            node, _ = self._quietly(without_context(good), "rule")
        if len(self.diagnostics) == before:  # all parts are right, but not together
            self._fail(piece, error)
        if node is not None:
            node.whole = False
        else:
            self._lose(piece)
        return node

    # --------------------------------------------------------------------------------- parsing

    def _quietly(self, piece: list[Token], start: str) -> tuple[Any, Exception | None]:
        """The node of a piece and None, or None and the error."""
        try:
            return parse_tokens(piece, start), None
        except SYNTAX_ERRORS as error:
            return None, error

    def _try(self, piece: list[Token], start: str) -> Any:
        """The node of a piece; None, and a report, if it does not parse."""
        node, error = self._quietly(piece, start)
        if error is not None:
            self._fail(piece, error)
        return node

    def _fail(self, piece: list[Token], error: Exception) -> None:
        """Report why a piece does not parse, unless a bad token in it says so already."""
        self._lose(piece)
        if self._is_full or any(token.type == BAD for token in piece):
            return
        if isinstance(error, syntax.NestingError):
            begin, end = syntax.extent(error.node)
            self.diagnostics.append(nesting_diagnostic(Span(self.source, begin, end)))
        else:
            self.diagnostics.append(explain(error, piece, self.stream))

    def _lose(self, piece: list[Token]) -> None:
        self.lost.update(token.value for token in piece if token.type.startswith("NAME"))

    def _error(self, code: str, message: str, token: Token, hint: str | None = None) -> None:
        span = Span(self.source, token.start, token.end)
        self.diagnostics.append(Diagnostic("error", code, message, span, hint))


def _stand_in(near: Token) -> list[Token]:
    """The tokens of ``rule x { outcomes { } }``."""
    words = [("RULE", "rule"), ("NAME", "x"), ("LBRACE", "{"), ("OUTCOMES", "outcomes")]
    signs = [("LBRACE", "{"), ("RBRACE", "}"), ("RBRACE", "}")]
    return [sign(type_, value, near) for type_, value in words + signs]
