"""Reading files: from bytes to a text, and from a problem to the file of its domain."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from menid_plan.errors import InputError, LimitError
from menid_plan.language.check import CheckResult, Known, check_syntax
from menid_plan.language.parse import parse
from menid_plan.language.recover import SyntaxResult
from menid_plan.model.domain import Domain, Problem
from menid_plan.source import Diagnostic, SourceFile, Span

# A file larger than this is refused before it is read whole.
MAX_BYTES = 4 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class Document:
    """A domain, a problem, or both: what a file holds, with a problem's domain found beside it."""

    domain: Domain | None
    problem: Problem | None


def decode(data: bytes, name: str) -> tuple[SourceFile, list[Diagnostic]]:
    """The text of a file's bytes; with a diagnostic if they are not UTF-8.

    A leading byte-order mark is dropped, and every line end becomes a line feed. Raises LimitError if
    there are more than MAX_BYTES.
    """
    if len(data) > MAX_BYTES:
        limit = f"{MAX_BYTES // 2**20} MiB"
        raise LimitError(f"{name}: the file is larger than the limit of {limit}")
    data = data.removeprefix(b"\xef\xbb\xbf")
    try:
        return SourceFile(name, _one_line_end(data.decode("utf-8"))), []
    except UnicodeDecodeError as error:
        start = len(_one_line_end(data[: error.start].decode("utf-8")))
        source = SourceFile(name, _one_line_end(data.decode("utf-8", errors="replace")))
        diagnostic = Diagnostic(
            "error", "M001", f"byte 0x{data[error.start]:02x} is not UTF-8",
            Span(source, start, start + 1), "save the file as UTF-8",
        )  # fmt: skip
        return source, [diagnostic]


def _one_line_end(text: str) -> str:
    return text.replace("\r\n", "\n").replace("\r", "\n")


def load(path: str | Path) -> bytes:
    """The bytes of a file, of standard input for ``-``: at most one more than MAX_BYTES."""
    if str(path) == "-":
        if sys.stdin is None:
            return b""  # the caller closed it
        return sys.stdin.buffer.read(MAX_BYTES + 1)
    with open(path, "rb") as file:
        return file.read(MAX_BYTES + 1)


def check_files(
    paths: Iterable[str | Path],
    contents: Mapping[str, bytes] | None = None,
    *,
    together: bool = False,
) -> list[CheckResult]:
    """Check files, each problem against its domain; one result for each path, in order.

    The domain of a problem that stands alone is looked for among the files, then beside it. If a
    domain found beside it has errors, they are reported with the problem's. ``contents`` has the
    bytes of files that were read already. With ``together`` a domain among the files is the one that
    is meant, whatever its name.
    """
    contents = contents or {}
    texts = [
        (path, *decode(contents.get(str(path)) or load(path), shown_name(path))) for path in paths
    ]
    parsed = [(path, None if bad else parse(source), bad) for path, source, bad in texts]
    known: dict[tuple[Path, str], Known] = {}
    results: dict[int, CheckResult] = {}
    for index, (path, syntax, bad) in enumerate(parsed):
        if syntax is None:
            results[index] = CheckResult(None, None, tuple(bad))
        elif syntax.file.domain is not None or syntax.file.problem is None:
            results[index] = check_syntax(syntax)
            own = results[index].known
            if own is not None:
                known.setdefault((Path(path).parent, own.domain.name), own)
    for index, (path, syntax, _) in enumerate(parsed):
        if syntax is not None and index not in results:
            results[index] = _check_problem(syntax, Path(path), known, together)
    return [results[index] for index in range(len(parsed))]


def shown_name(path: str | Path) -> str:
    """What messages call a file."""
    return "<stdin>" if str(path) == "-" else str(path)


def _check_problem(
    syntax: SyntaxResult, path: Path, known: dict[tuple[Path, str], Known], together: bool
) -> CheckResult:
    """Check a problem that stands alone in its file; ``known`` are the domains of other files."""
    assert syntax.file.problem is not None
    token = syntax.file.problem.domain
    beside: tuple[Diagnostic, ...] = ()
    domain = known.get((path.parent, token.value))
    if together and known:
        domain = next(iter(known.values()))
    elif domain is None and (found := find_domain(path, token.value)) is not None:
        source, bad = decode(load(found), str(found))
        result = CheckResult(None, None, tuple(bad)) if bad else check_syntax(parse(source))
        beside = tuple(d for d in result.diagnostics if d.is_error)
        if result.known is not None:
            domain = known[path.parent, token.value] = result.known
    if domain is None:
        named = [k for (_, name), k in known.items() if name == token.value]
        # The only domain that was given must be the one that is meant, whatever its name.
        domain = next(iter(named or (known.values() if len(known) == 1 else ())), None)
    result = check_syntax(syntax, domain)
    if domain is None and not beside:
        missing = Diagnostic(
            "error", "M213", f"the domain `{token.value}` was not found",
            Span(syntax.stream.source, token.start, token.end),
            "give its file as well, or put it beside the problem as domain.menid",
        )  # fmt: skip
        return CheckResult(None, None, (*result.diagnostics, missing))
    if beside:
        return CheckResult(None, None, (*beside, *result.diagnostics))
    return result


def find_domain(problem: Path, name: str) -> Path | None:
    """The file beside a problem's that declares the domain: ``domain.menid`` first."""
    folder = Path() if str(problem) == "-" else problem.parent
    declares = re.compile(
        rb"^\s*domain\s+" + re.escape(name.encode()) + rb"(?![\w-])", re.MULTILINE
    )
    try:
        others = sorted(folder.glob("*.menid"))
    except OSError:
        return None
    for candidate in [folder / "domain.menid", *others]:
        try:
            if (
                candidate != problem
                and candidate.is_file()
                and declares.search(_plain(load(candidate)))
            ):
                return candidate
        except OSError:
            continue
    return None


def _plain(data: bytes) -> bytes:
    """The bytes without a byte-order mark, comments and strange line ends."""
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r", b"\n")
    return re.sub(rb"#[^\n]*", b"", data)


def parse_text(text: str, domain: Domain | None = None, *, name: str = "<text>") -> Document:
    """Read a text that holds a domain, a problem, or both.

    A problem that stands alone needs its ``domain``. Raises InputError with all diagnostics if there
    is an error.
    """
    source = SourceFile(name, _one_line_end(text.removeprefix("\ufeff")))
    syntax = parse(source)
    if syntax.file.problem is not None and syntax.file.domain is None and domain is None:
        result = check_syntax(syntax)
        token = syntax.file.problem.domain
        missing = Diagnostic(
            "error", "M213", f"the domain `{token.value}` was not given",
            Span(source, token.start, token.end), "pass it as `domain`",
        )  # fmt: skip
        raise InputError((*result.diagnostics, missing))
    return _document(check_syntax(syntax, Known.of(domain) if domain else None))


def read(path: str | Path, domain: Domain | str | Path | None = None) -> Document:
    """Read a file that holds a domain, a problem, or both.

    The domain of a problem that stands alone is ``domain`` (a value or a file), or is looked for
    beside it. Raises InputError with all diagnostics if there is an error, OSError if a file can't
    be read, LimitError if it is too large.
    """
    if isinstance(domain, Domain):
        source, bad = decode(load(path), shown_name(path))
        if bad:
            raise InputError(bad)
        return _document(check_syntax(parse(source), Known.of(domain)))
    results = check_files([path] if domain is None else [path, domain], together=True)
    return _document(*results)


def _document(result: CheckResult, *others: CheckResult) -> Document:
    """What the first result holds, if none has errors."""
    diagnostics = [d for r in (result, *others) for d in r.diagnostics]
    if any(d.is_error for d in diagnostics):
        raise InputError(diagnostics)
    return Document(result.known.domain if result.known else None, result.problem)
