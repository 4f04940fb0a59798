"""docs/diagnostics.md has every code, with a text that really gives it and one that does not."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from menid_plan.language.files import check_files
from test_docs import ROOT, Block, blocks, codes

PAGE = ROOT / "docs" / "diagnostics.md"

_HEADING = re.compile(r"^### (M[0-9]{3})$")
_FIRST_SENTENCE = re.compile(r"\*\*[A-Z`][^*]+[.,]?\*\*( \(a warning\)[.])?")


@dataclass(frozen=True)
class Entry:
    """A code's part of the page."""

    code: str
    text: str
    wrong: tuple[Block, ...]
    right: tuple[Block, ...]
    python: tuple[Block, ...]
    console: tuple[Block, ...]


def _entries() -> Iterator[Entry]:
    lines = PAGE.read_text(encoding="utf-8").split("\n")
    starts = [
        (number, found[1])
        for number, line in enumerate(lines, start=1)
        if (found := _HEADING.match(line))
    ]
    on_page = list(blocks(PAGE))
    ends = [start for start, _ in starts[1:]] + [len(lines) + 1]
    for (start, code), end in zip(starts, ends, strict=True):
        own = [block for block in on_page if start < block.line < end]
        menid = [block for block in own if block.language == "menid"]
        yield Entry(
            code,
            "\n".join(lines[start:end]).strip(),
            tuple(block for block in menid if "wrong" in block.options),
            tuple(block for block in menid if "wrong" not in block.options),
            tuple(block for block in own if block.language == "python"),
            tuple(block for block in own if block.language == "console"),
        )


ENTRIES = list(_entries())


def test_the_page_has_the_codes_of_the_source_in_order() -> None:
    source = "\n".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "menid_plan").rglob("*.py")
    )
    assert [entry.code for entry in ENTRIES] == sorted(set(re.findall(r"\bM[0-9]{3}\b", source)))


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.code)
def test_an_entry_has_its_parts(entry: Entry) -> None:
    assert _FIRST_SENTENCE.match(entry.text)
    if entry.console:
        # Found in what is given on the command line; test_docs.py runs these.
        first, second = entry.console
        assert f"error[{entry.code}]" in first.text
        assert "error[" not in second.text
        assert not entry.wrong
    elif entry.python:
        # Bytes, and texts too long for a page; test_docs.py runs these.
        first, second = entry.python
        assert f'"{entry.code}"' in first.text
        assert "== []" in second.text
        assert not entry.wrong
    else:
        assert len(entry.wrong) == len(entry.right) > 0


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.code)
def test_the_examples_of_an_entry(
    entry: Entry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert all(entry.code in codes(block.text) for block in entry.wrong)
    assert not any(codes(block.text) for block in entry.right)


def test_the_warnings_are_those_that_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("block.menid")
    for entry in ENTRIES:
        for block in entry.wrong:
            path.write_text(block.text, encoding="utf-8")
            severities = {
                d.severity for d in check_files([path])[0].diagnostics if d.code == entry.code
            }
            is_warning = "(a warning)" in entry.text.split("\n")[0]
            assert severities == {"warning" if is_warning else "error"}, entry.code
