"""From a syntax tree to a Domain and a Problem, with everything that is wrong with them.

Every declaration is looked at whatever is wrong with the others; a value is given only if nothing is.
"""

from __future__ import annotations

from dataclasses import dataclass

from menid_plan.language.check_domain import DomainChecker
from menid_plan.language.check_problem import ProblemChecker
from menid_plan.language.declarations import Documentation
from menid_plan.language.names import Names, names_of
from menid_plan.language.parse import parse
from menid_plan.language.recover import SyntaxResult
from menid_plan.language.report import Report
from menid_plan.model.domain import (
    Domain,
    Problem,
    param_values,
)
from menid_plan.source import Diagnostic, SourceFile, in_order

# Past this many diagnostics of a text the rest is not listed.
MAX_DIAGNOSTICS = 1000


@dataclass(frozen=True, slots=True)
class Known:
    """A domain to check problems against, as far as it is without errors.

    ``lost_names`` are names that its text may declare in parts that could not be read.
    """

    domain: Domain
    names: Names
    lost_names: frozenset[str] = frozenset()
    is_sound: bool = True  # False if there are errors in its text

    @staticmethod
    def of(domain: Domain) -> Known:
        """A domain that is without errors."""
        return Known(domain, names_of(domain, param_values(domain)))


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What a text holds. ``domain`` and ``problem`` are None if absent or with errors.

    ``known`` is the domain of the text, or the one that its problem was checked against, as far as it
    could be understood, errors or not.
    """

    domain: Domain | None
    problem: Problem | None
    diagnostics: tuple[Diagnostic, ...]
    known: Known | None = None

    @property
    def has_errors(self) -> bool:
        """Whether any diagnostic is an error."""
        return any(d.is_error for d in self.diagnostics)


def check(source: SourceFile, known: Known | None = None) -> CheckResult:
    """Parse and check a text; ``known`` is the domain of a problem that stands alone in its text."""
    return check_syntax(parse(source), known)


def check_syntax(result: SyntaxResult, known: Known | None = None) -> CheckResult:
    """Check a parsed text; see `check`."""
    lost = result.lost_names | (known.lost_names if known else set())
    report = Report(result.stream.source, lost)
    _reserved_names(result, report)
    docs = Documentation(result.stream.comments, result.stream.source)
    tree = result.file
    if tree.domain is None and tree.problem is None and not result.diagnostics:
        report.warning("M104", "the text holds neither a domain nor a problem", report.start)
    domain: Domain | None = None
    problem: Problem | None = None
    if tree.domain is not None:
        checker = DomainChecker(report, docs)
        domain = checker.domain(tree.domain)
        sound = not result.diagnostics and not report.knows_errors
        known = Known(domain, checker.names, frozenset(result.lost_names), sound)
    if tree.problem is not None and known is not None:
        names = known.names.for_problem()
        checks = ProblemChecker(report, names, docs, domain_is_sound=known.is_sound)
        problem = checks.problem(tree.problem, known.domain)
    diagnostics = _at_most(in_order([*result.diagnostics, *report.diagnostics]))
    if any(d.is_error for d in diagnostics):
        return CheckResult(None, None, diagnostics, known)
    return CheckResult(domain, problem, diagnostics, known)


def _at_most(diagnostics: list[Diagnostic]) -> tuple[Diagnostic, ...]:
    """The first MAX_DIAGNOSTICS, and that there are more."""
    if len(diagnostics) <= MAX_DIAGNOSTICS:
        return tuple(diagnostics)
    message = f"more than {MAX_DIAGNOSTICS} errors: the rest is not listed"
    last = diagnostics[MAX_DIAGNOSTICS]
    errors = sorted(diagnostics, key=lambda d: not d.is_error)[:MAX_DIAGNOSTICS]
    return (*in_order(errors), Diagnostic("error", "M106", message, last.span))


def _reserved_names(result: SyntaxResult, report: Report) -> None:
    """A reserved word before a colon lexes as a name; report those that parsed as one."""
    from menid_plan.language.grammar import lexer

    known = {d.span.start for d in result.diagnostics}
    for token in result.stream.tokens:
        reserved = token.type == "NAME_COLON" and token.value in lexer().reserved_words
        if reserved and token.start not in known:
            message = f"`{token.value}` is a reserved word and can't be a name"
            report.error("M102", message, token)
