"""Reads ground atoms and actions that stand outside of files: ``in(board, tray), loose(board)``."""

from __future__ import annotations

from typing import Any

from menid_plan.errors import InputError
from menid_plan.language.check_formulas import FormulaChecker
from menid_plan.language.grammar import SYNTAX_ERRORS, lexer, parse_tokens
from menid_plan.language.names import Names, names_of
from menid_plan.language.report import Report
from menid_plan.language.syntax_errors import explain
from menid_plan.language.tokens import TokenStream
from menid_plan.model.domain import Domain, Problem, param_values
from menid_plan.model.formulas import GroundAtom
from menid_plan.source import Diagnostic, SourceFile


def read_state(text: str, domain: Domain, problem: Problem, name: str) -> frozenset[GroundAtom]:
    """The state that a list of ground basic atoms describes; an empty text is the empty state.

    ``name`` is what messages call the text. Raises InputError.
    """
    stream = lexer().split(SourceFile(name, text))
    report = Report(stream.source)
    checker = FormulaChecker(report, _names(domain, problem))
    atoms = [
        checker.atom(node, {}, basic_for="in a state") for node in _parsed(stream, "atoms", [])
    ]
    if report.diagnostics:
        raise InputError(report.diagnostics)
    return frozenset(GroundAtom(a.predicate, tuple(t.name for t in a.arguments)) for a in atoms)


def read_action(text: str, domain: Domain, problem: Problem, name: str) -> GroundAtom:
    """An action and its objects, as an atom: ``lever(n1)``; see `read_state`."""
    stream = lexer().split(SourceFile(name, text))
    report = Report(stream.source)
    node = _parsed(stream, "atom", None)
    # An action is looked up as a predicate is, with its parameters' types as the arguments'.
    names = _names(domain, problem)
    names.predicates = {a.name: tuple(v.types for v in a.parameters) for a in domain.actions}
    names.derived = {}
    if node is None or node.name.value not in names.predicates:
        if node is None:
            report.error("M215", "an action is asked for", report.start, "for example lever(n1)")
        else:
            report.unknown("M215", "action", node.name, names.predicates)
        raise InputError(report.diagnostics)
    atom = FormulaChecker(report, names).atom(node, {})
    if report.diagnostics:
        raise InputError(report.diagnostics)
    return GroundAtom(atom.predicate, tuple(term.name for term in atom.arguments))


def _names(domain: Domain, problem: Problem) -> Names:
    names = names_of(domain, param_values(domain, problem))
    names.objects.update((o.name, o.type) for o in problem.objects)
    return names


def _parsed(stream: TokenStream, start: str, nothing: Any) -> Any:
    """The node of a text; ``nothing`` if it has no tokens."""
    diagnostics: list[Diagnostic] = list(stream.diagnostics)
    if not stream.tokens:
        return nothing
    if not diagnostics:
        try:
            return parse_tokens(stream.tokens, start)
        except SYNTAX_ERRORS as error:
            diagnostics.append(explain(error, stream.tokens, stream))
    raise InputError(diagnostics)
