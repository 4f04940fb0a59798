"""menid-plan: a rule language for robot actions, learning in several environments, planning.

>>> import menid_plan
>>> document = menid_plan.parse("domain lamp  predicate on  problem dark for lamp  goal on")
>>> document.domain.name, document.problem.goal
('lamp', Atom(predicate='on', arguments=()))
"""

from menid_plan.errors import InputError, LimitError, MeaningError, MenidError
from menid_plan.language.files import Document, read
from menid_plan.language.files import parse_text as parse
from menid_plan.language.write import write
from menid_plan.model.domain import Domain, Problem
from menid_plan.source import Diagnostic, SourceFile, Span

__version__ = "0.1.0"

__all__ = [
    "Diagnostic",
    "Document",
    "Domain",
    "InputError",
    "LimitError",
    "MeaningError",
    "MenidError",
    "Problem",
    "SourceFile",
    "Span",
    "parse",
    "read",
    "write",
]
