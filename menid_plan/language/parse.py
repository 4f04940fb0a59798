"""From a text to its syntax tree, with every syntax error that can be found.

A text without errors is parsed in one go. Where that fails, the tokens are cut at the words that
start a declaration, a rule or a row, and each piece is parsed alone, so that an error in one does
not hide those in the others. This module alone imports Lark, and only when a text is parsed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from menid_plan.language import syntax
from menid_plan.language.grammar import SYNTAX_ERRORS, lexer, parse_tokens
from menid_plan.language.syntax import Token
from menid_plan.language.syntax_errors import explain
from menid_plan.language.tokens import BAD, TokenStream, nesting_diagnostic
from menid_plan.source import Diagnostic, SourceFile, Span


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


def parse(source: SourceFile) -> SyntaxResult:
    """Parse a text. Never raises for what the text holds."""
    stream = lexer().split(source)
    if not stream.diagnostics:
        with suppress(*SYNTAX_ERRORS):
            return SyntaxResult(stream, parse_tokens(stream.tokens, "file"), [])
    return _Recovery(stream).run()


# ---------------------------------------------------------------------------------------- recovery

_DOMAIN_STARTS = frozenset(
    "TYPE CONSTANT PARAM ENVIRONMENT PREDICATE DERIVED REWARD ACTION".split()
)
_PROBLEM_STARTS = frozenset("PARAM OBJECT INIT GOAL HORIZON DISCOUNT DEAD_END".split())
_HEADERS = frozenset(["DOMAIN", "PROBLEM"])
# These words may also stand inside a declaration; they start one only outside all brackets.
_AMBIGUOUS = frozenset(["REWARD", "OBJECT", "DEAD_END"])
# After these a name follows.
_NAMING = frozenset("DOMAIN PROBLEM TYPE PARAM PREDICATE DERIVED ACTION".split())
_DECLARATION_STARTS = _DOMAIN_STARTS | _PROBLEM_STARTS | _HEADERS

_INSTEAD = {
    "OBJECT": "a domain declares the objects that every problem has as `constant`",
    "PREDICATE": "predicates are declared in the domain",
    "CONSTANT": "a problem declares its things as `object`",
    "REWARD": "state rewards are declared in the domain; a problem has `goal FORMULA reward EXPR`",
}


# Past this many syntax errors the rest of a text is not looked at: it is no MENID.
MAX_SYNTAX_ERRORS = 100


class _Recovery:
    """Reads piece by piece a text that does not parse as a whole."""

    def __init__(self, stream: TokenStream) -> None:
        self.stream = stream
        self.source = stream.source
        self.diagnostics = list(stream.diagnostics)
        self.lost: set[str] = set()
        self.domain: syntax.Domain | None = None
        self.problem: syntax.Problem | None = None

    def run(self) -> SyntaxResult:
        pieces = list(declarations(self.stream.tokens))
        for piece in pieces:
            if self._is_full:
                self._error(
                    "M106", f"more than {MAX_SYNTAX_ERRORS} syntax errors: the rest is not read",
                    piece[0],
                )  # fmt: skip
                self.lost.update(t.value for t in self.stream.tokens if t.type.startswith("NAME"))
                break
            if piece[0].type in _HEADERS:
                self._header(piece)
            elif piece[0].type in _DECLARATION_STARTS:
                self._declaration(piece)
            else:
                self._try(piece, "file")
        self.diagnostics.extend(self._unclosed(pieces))
        tree = syntax.File(self.domain, self.problem)
        return SyntaxResult(self.stream, tree, self.diagnostics, self.lost)

    @property
    def _is_full(self) -> bool:
        return len(self.diagnostics) - len(self.stream.diagnostics) >= MAX_SYNTAX_ERRORS

    def _header(self, piece: list[Token]) -> None:
        kind = "domain" if piece[0].type == "DOMAIN" else "problem"
        taken = self.problem or (self.domain if kind == "domain" else None)
        if taken is not None:
            message = f"a second `{kind}` in one file"
            if kind == "domain" and self.domain is None:
                message = "the domain comes after the problem"
            self._error("M103", message, piece[0], "a file holds a domain, then a problem")
            return
        node = self._try(piece, kind)
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
            self._error(
                "M103", f"`{keyword.value}` stands before any `domain` or `problem`", keyword,
                "a file starts with `domain NAME` or `problem NAME for DOMAIN`",
            )  # fmt: skip
            return
        allowed = _PROBLEM_STARTS if self.problem else _DOMAIN_STARTS
        if keyword.type not in allowed:
            place = "problem" if self.problem else "domain"
            self._error(
                "M103", f"`{keyword.value}` does not belong in a {place}", keyword,
                _INSTEAD.get(keyword.type),
            )  # fmt: skip
        elif node is not None:
            items: list[Any] = here.items
            items.append(node)

    def _action(self, piece: list[Token]) -> syntax.Action | None:
        node: syntax.Action | None
        node, error = self._quietly(piece, "action")
        if error is None:
            return node
        starts = [i for i, token in enumerate(piece) if token.type == "RULE"]
        if not starts:
            self._fail(piece, error)
            return None
        before = len(self.diagnostics)
        head, close = piece[: starts[0]], _closing(piece)
        rules = []
        for start, end in zip(starts, [*starts[1:], len(piece)], strict=True):
            rule = self._rule(_balanced(piece[start:end]))
            if rule is not None:
                rules.append(rule)
        # The head is right if it parses before a rule that is.
        node = self._try([*head, *_stand_in(head[-1]), close], "action")
        if len(self.diagnostics) == before:  # all parts are right, but not together
            self._fail(piece, error)
        if node is not None:
            node.rules = rules
        return node

    def _rule(self, piece: list[Token]) -> syntax.Rule | None:
        node: syntax.Rule | None
        node, error = self._quietly(piece, "rule")
        if error is None:
            return node
        before = len(self.diagnostics)
        without_rows = []
        for is_row, part in _rows(piece):
            if is_row and self._try(part, is_row) is None:
                continue
            without_rows.extend(part)
        self._try(without_rows, "rule")
        if len(self.diagnostics) == before:  # all parts are right, but not together
            self._fail(piece, error)
        self.lost.update(t.value for t in piece if t.type.startswith("NAME"))
        return None  # rows are missing: what is left would not sum to 1

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
        self.lost.update(t.value for t in piece if t.type.startswith("NAME"))
        if self._is_full or any(token.type == BAD for token in piece):
            return
        if _is_open(piece) and _at_end(error):
            return  # an open brace is reported as such
        if isinstance(error, syntax.NestingError):
            begin, end = syntax.extent(error.node)
            self.diagnostics.append(nesting_diagnostic(Span(self.source, begin, end)))
        else:
            self.diagnostics.append(explain(error, piece, self.stream))

    def _error(self, code: str, message: str, token: Token, hint: str | None = None) -> None:
        span = Span(self.source, token.start, token.end)
        self.diagnostics.append(Diagnostic("error", code, message, span, hint))

    def _unclosed(self, pieces: list[list[Token]]) -> Iterator[Diagnostic]:
        """Braces that are still open where the next rule or declaration starts."""
        for piece in pieces:
            stack: list[Token] = []
            for token in piece:
                if token.value == "{":
                    stack.append(token)
                elif token.value == "}" and stack:
                    stack.pop()
                elif token.type == "RULE" and len(stack) > 1:
                    yield self._open(stack[-1], "the next rule starts")
                    del stack[1:]
            if stack:
                yield self._open(stack[-1], f"`{piece[0].value}` ends")

    def _open(self, brace: Token, where: str) -> Diagnostic:
        return Diagnostic(
            "error", "M105", f"`{{` is not closed before {where}",
            Span(self.source, brace.start, brace.end),
            "each action, rule, table and block ends with a `}` of its own",
        )  # fmt: skip


def _is_open(piece: list[Token]) -> bool:
    values = [token.value for token in piece]
    return values.count("{") > values.count("}")


def _at_end(error: Exception) -> bool:
    """Whether an error is that a piece ends too early."""
    token = getattr(error, "token", None)
    return token is not None and not (isinstance(token, Token) and token.start < token.end)


def declarations(tokens: list[Token]) -> Iterator[list[Token]]:
    """Cut the tokens before each word that starts a declaration."""
    piece: list[Token] = []
    depth = 0
    for token in tokens:
        if token.type in _DECLARATION_STARTS and _starts_declaration(token, piece, depth):
            if piece:
                yield piece
            piece, depth = [], 0
        elif token.value in ("(", "{"):
            depth += 1
        elif token.value in (")", "}"):
            depth = max(0, depth - 1)
        piece.append(token)
    if piece:
        yield piece


def _starts_declaration(token: Token, piece: list[Token], depth: int) -> bool:
    if len(piece) == 1 and piece[0].type in _NAMING:
        return False  # a reserved word in the place of a name
    if token.type not in _AMBIGUOUS:
        return True
    if depth > 0:
        return False
    if token.type == "OBJECT":
        return not piece or piece[-1].value not in (":", "<", "|", ",")
    if token.type == "REWARD" and piece and piece[0].type in ("GOAL", "DEAD_END"):
        return any(t.type == "REWARD" for t in piece)
    return True


def _balanced(piece: list[Token]) -> list[Token]:
    """A rule without the brace that closes its action."""
    depth = 0
    for i, token in enumerate(piece):
        if token.value == "{":
            depth += 1
        elif token.value == "}":
            depth -= 1
            if depth == 0 and all(t.value == "}" for t in piece[i:]):
                return piece[: i + 1]
    return piece


def _closing(piece: list[Token]) -> Token:
    last = piece[-1]
    return last if last.value == "}" else _sign("RBRACE", "}", last)


def _sign(type_: str, value: str, near: Token) -> Token:
    return Token(type_, value, near.end, near.end, near.index)


def _stand_in(near: Token) -> list[Token]:
    """The tokens of ``rule x { outcomes { } }``."""
    words = [("RULE", "rule"), ("NAME", "x"), ("LBRACE", "{"), ("OUTCOMES", "outcomes")]
    signs = [("LBRACE", "{"), ("RBRACE", "}"), ("RBRACE", "}")]
    return [_sign(type_, value, near) for type_, value in words + signs]


_TABLES = {"OUTCOMES": "row", "PROBABILITIES": "block_row", "OBSERVED": "block_row"}


def _rows(piece: list[Token]) -> Iterator[tuple[str, list[Token]]]:
    """The parts of a rule: each row with its start symbol, what is between them with ``""``."""
    table, depth = "", 0
    part: list[Token] = []
    kind = ""
    for token in piece:
        if token.type in _TABLES:
            table, depth = _TABLES[token.type], 0
        inside = bool(table) and depth == 1
        if inside and (token.type == "NAME_COLON" or token.value == "}"):
            if part:
                yield kind, part
            part, kind = [], table if token.type == "NAME_COLON" else ""
            if token.value == "}":
                table = ""
        if token.value == "{":
            depth += 1
        elif token.value == "}":
            depth -= 1
        part.append(token)
    if part:
        yield kind, part
