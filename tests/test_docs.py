"""Every example of README.md and docs/ runs, and gives what the page shows.

The first line of a code block says what is done with it:

    ```menid                            a whole file: no errors, no warnings
    ```menid name=lamp.menid            the same, and kept under that name for later blocks
    ```menid wrong=M203                 a whole file in which that code and no other is found
                                        (wrong=M203+: others may be found too)
    ```menid fragment=KIND in=FILE      a part, tried inside a kept file; KIND is one of FRAMES,
                                        with="x: block" declares what the part may name
    ```menid fragment                   a part that is not tried
    ```text name=model.pddl             not run, and kept under that name
    ```python                           a doctest if it has `>>>`, else executed
    ```console                          lines after `$ ` are run, what they print is compared;
                                        exit=3 is the exit code of the last one
    ```sh, text, json, toml             not run

In doctests and consoles, `...` stands for anything. The blocks of a page run in order in one folder
of their own, which has a copy of domains/.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from menid_plan.cli import learn
from menid_plan.cli.main import main
from menid_plan.cli.tasks import Display
from menid_plan.grounding.formulas import WORK_LIMIT
from menid_plan.language.declarations import MAX_RANGE
from menid_plan.language.files import MAX_BYTES, check_files
from menid_plan.language.grammar import lexer
from menid_plan.language.recover import MAX_SYNTAX_ERRORS
from menid_plan.language.syntax import MAX_NESTING

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if "_build" not in page.parts]

NOT_RUN = {"sh", "text", "json", "toml", ""}

_FLAGS = doctest.ELLIPSIS


@dataclass(frozen=True)
class Block:
    """A fenced code block: where it starts, the words behind the fence, and its text."""

    page: Path
    line: int
    language: str
    words: frozenset[str]
    options: dict[str, str] = field(hash=False)
    text: str = field(repr=False)

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


_FENCE = re.compile(r"^(?P<indent> *)(?P<fence>`{3,}|:{3,})(?P<info>.*)$")


def blocks(page: Path) -> Iterator[Block]:
    """The code blocks of a page; directives (```{name}) are left out."""
    lines = iter(enumerate(page.read_text(encoding="utf-8").split("\n"), start=1))
    for number, line in lines:
        opening = _FENCE.match(line)
        if opening is None:
            continue
        closing = re.compile(rf"^ *{re.escape(opening['fence'])} *$")
        inside = []
        for _, text in lines:
            if closing.match(text):
                break
            inside.append(text.removeprefix(opening["indent"]))
        else:
            raise AssertionError(f"{page}:{number}: a code block is never closed")
        language, *words = shlex.split(opening["info"]) or [""]
        if language.startswith("{"):
            continue
        options = dict(word.split("=", 1) for word in words if "=" in word)
        plain = frozenset(word for word in words if "=" not in word)
        yield Block(page, number, language, plain, options, "\n".join(inside) + "\n")


# ------------------------------------------------------------------------------------ MENID blocks


def _declarations(context: str, text: str, _names: str) -> str:
    return f"{context}\n{text}"


def _rule(context: str, text: str, names: str) -> str:
    return f"{context}\naction try-it({names}) {{\n{text}\n}}\n"


def _formula(context: str, text: str, names: str) -> str:
    formulas = [line.partition("#")[0].strip() for line in text.splitlines()]
    return context + "".join(
        f"\nderived try-{number}({names}) = {formula}"
        for number, formula in enumerate(formulas)
        if formula
    )


def _expression(context: str, text: str, _names: str) -> str:
    expressions = [line.partition("#")[0].strip() for line in text.splitlines()]
    return context + "".join(
        f"\nparam try-{number} = {expression}"
        for number, expression in enumerate(expressions)
        if expression
    )


def _problem(context: str, text: str, names: str) -> str:
    found = re.search(r"^domain\s+(\S+)", context, re.MULTILINE)
    assert found is not None
    objects = f"object {names}\n" if names else ""
    return f"{context}\nproblem try-it for {found[1]}\n{objects}{text}"


FRAMES: dict[str, Callable[[str, str, str], str]] = {
    "declarations": _declarations,
    "rule": _rule,
    "formula": _formula,  # each line is a formula
    "expression": _expression,  # each line is an expression
    "problem": _problem,
}


def codes(text: str, name: str = "block.menid") -> list[str]:
    """The codes of all that is found in a text, which is a file in the current folder meanwhile."""
    path = Path(name)
    path.write_text(text, encoding="utf-8")
    try:
        return [d.code for d in check_files([path])[0].diagnostics]
    finally:
        path.unlink()


def run_menid(block: Block) -> None:
    """Check a ```menid block, and keep it if it has a name."""
    text = block.text
    if "fragment" in block.words:
        return
    if "fragment" in block.options:
        frame = FRAMES[block.options["fragment"]]
        context = Path(block.options["in"]).read_text(encoding="utf-8")
        text = frame(context, text, block.options.get("with", ""))
    found = codes(text)
    wanted = block.options.get("wrong")
    if wanted is None:
        assert not found, f"it should be right, but there is {found}"
    elif wanted.endswith("+"):
        assert wanted[:-1] in found, f"it should give {wanted}, and gives {found}"
    else:
        assert set(found) == {wanted}, f"it should give {wanted}, and gives {found}"
    if "name" in block.options:
        Path(block.options["name"]).write_text(text, encoding="utf-8")


# ----------------------------------------------------------------------------------- Python blocks


def run_python(block: Block, names: dict[str, Any]) -> None:
    """Run a ```python block; what it defines stays for the blocks after it."""
    if ">>>" not in block.text:
        code = compile("\n" * block.line + block.text, str(block.page), "exec")
        exec(code, names)
        return
    parser = doctest.DocTestParser()
    test = parser.get_doctest(block.text, names, str(block), str(block.page), block.line)
    runner = doctest.DocTestRunner(optionflags=_FLAGS, verbose=False)
    said = io.StringIO()
    runner.run(test, out=said.write, clear_globs=False)
    names.update(test.globs)
    assert runner.failures == 0, said.getvalue()


# ---------------------------------------------------------------------------------- console blocks


def run_console(block: Block) -> None:
    """Run the commands of a ```console block and compare what they print."""
    commands = _commands(block)
    exit_code = 0
    for index, (command, wanted) in enumerate(commands):
        said, exit_code = _run(command, exit_code)
        said, wanted = _stripped(said), _stripped(wanted)
        same = doctest.OutputChecker().check_output(wanted, said, _FLAGS)
        assert same, f"$ {command}\nthe page shows:\n{wanted}\nit prints:\n{said}"
        if not command.startswith("echo"):
            declared = int(block.options.get("exit", 0)) if index == len(commands) - 1 else None
            following = commands[index + 1][0] if index + 1 < len(commands) else ""
            if declared is None and not following.startswith("echo"):
                declared = 0
            assert declared in (None, exit_code), f"$ {command} exits with {exit_code}"


def _commands(block: Block) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for line in block.text.removesuffix("\n").split("\n"):
        if line.startswith("$ "):
            found.append((line[2:], ""))
        else:
            assert found, "a console block starts with `$ `"
            found[-1] = (found[-1][0], found[-1][1] + line + "\n")
    return found


def _run(command: str, last_exit: int) -> tuple[str, int]:
    """What a command prints, standard error included, and its exit code."""
    program, *arguments = shlex.split(command)
    given = None
    if "<" in arguments:
        at = arguments.index("<")
        given = Path(arguments[at + 1]).read_bytes()
        arguments = arguments[:at]
    if program == "menid":
        result = CliRunner().invoke(main, arguments, input=given, prog_name="menid")
        unexpected = result.exception
        if unexpected is not None and not isinstance(unexpected, SystemExit):
            raise AssertionError(f"$ {command} raises {unexpected!r}") from unexpected
        return result.output, result.exit_code
    if program == "cat":
        return "".join(Path(name).read_text(encoding="utf-8") for name in arguments), 0
    if program == "cd":
        os.chdir(arguments[0])
        return "", 0
    if command == "echo $?":
        return f"{last_exit}\n", 0
    raise AssertionError(f"no way to run `{program}` here; make it a ```sh block")


def _stripped(text: str) -> str:
    """A text without white space at the ends of its lines, and without empty lines at its end."""
    text = "\n".join(line.rstrip() for line in text.split("\n")).rstrip("\n")
    return text + "\n" if text else ""


# ------------------------------------------------------------------------------------------- tests


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a page, made the current one."""
    shutil.copytree(ROOT / "domains", tmp_path / "domains")
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)
    # Pages show a machine that is not slow.
    monkeypatch.setattr(Display, "FIRST", math.inf)
    monkeypatch.setattr(learn._View, "EVERY", math.inf)
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
@pytest.mark.usefixtures("folder")
def test_every_block_of_a_page(page: Path) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    wrong: list[str] = []
    for block in blocks(page):
        try:
            if block.language == "menid":
                run_menid(block)
            elif block.language == "python":
                run_python(block, names)
            elif block.language == "console":
                run_console(block)
            else:
                assert block.language in NOT_RUN, f"what is a ```{block.language} block?"
                if "name" in block.options:
                    Path(block.options["name"]).write_text(block.text, encoding="utf-8")
        except Exception as error:  # all faults of a page at once
            wrong.append(f"{block}: {error}")
    assert not wrong, "\n\n".join(wrong)


def test_the_reference_lists_the_reserved_words() -> None:
    page = (ROOT / "docs" / "language.md").read_text(encoding="utf-8")
    listed = page.partition("### Reserved words")[2].partition("```text\n")[2].partition("```")[0]
    assert listed.split() == sorted(lexer().reserved_words)


def test_the_reference_states_the_limits() -> None:
    page = (ROOT / "docs" / "language.md").read_text(encoding="utf-8")
    limits = page.partition("## Limits")[2]
    for limit in (
        f"{MAX_BYTES // 2**20} MiB",
        f"{MAX_NESTING} levels",
        f"{MAX_RANGE}",
        f"{MAX_SYNTAX_ERRORS}",
        f"{WORK_LIMIT // 10**6} million",
    ):
        assert f"| {limit} |" in limits


_LINK = re.compile(r"\]\((?P<target>[^)#\s]+)(?:#[^)]*)?\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_files_lead_somewhere(page: Path) -> None:
    targets = [link["target"] for link in _LINK.finditer(page.read_text(encoding="utf-8"))]
    files = [target for target in targets if not re.match(r"[a-z]+:", target)]
    assert [target for target in files if not (page.parent / target).exists()] == []


@pytest.mark.skipif(
    not all(map(find_spec, ("sphinx", "myst_parser", "furo"))),
    reason="needs the extra `docs`: sphinx, myst-parser and furo",
)
def test_the_pages_build_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, "-d", tmp_path / "doctrees", ROOT / "docs", tmp_path / "html"],
        capture_output=True,
        check=False,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "html" / "index.html").exists()


# ------------------------------------------------------------------------- tests of what is above


def _page(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "page.md"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def try_page(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Runs a page given as text; gives what is wrong with it, or nothing."""
    monkeypatch.setattr(sys.modules[__name__], "ROOT", folder)

    def run(text: str) -> str:
        with contextlib.suppress(AssertionError):
            test_every_block_of_a_page(_page(folder, text))
            return ""
        return "fails"

    return run


GOOD = "```menid name=a.menid\ndomain a\npredicate p\n```\n"


@pytest.mark.parametrize(
    "text",
    [
        "no blocks",
        GOOD + "```console\n$ menid check a.menid -q\n$ cat a.menid\ndomain a\n...\n```\n",
        GOOD + "```menid\nproblem b for a\ngoal p\n```\n",
        GOOD + "```menid fragment=formula in=a.menid\np and not p\n```\n",
        GOOD + "```menid fragment=formula in=a.menid wrong=M203\nq\n```\n",
        "```console\n$ menid check none.menid\nUsage: ...\n$ echo $?\n2\n```\n",
        "```console exit=2\n$ menid check none.menid\nUsage: ...\n```\n",
        "```python\nx = 1\n```\n```python\n>>> x\n1\n```\n",
        "```sh\npip install menid-plan\n```\n",
    ],
)
def test_a_page_that_tells_the_truth(try_page: Callable[[str], str], text: str) -> None:
    assert try_page(text) == ""


@pytest.mark.parametrize(
    "text",
    [
        "```menid\ndomain a\nderived d = p\n```\n",
        "```menid wrong=M203\ndomain a\n```\n",
        "```menid\nproblem b for a\n```\n",
        GOOD + "```menid fragment=formula in=a.menid\nq\n```\n",
        GOOD + "```console\n$ menid check a.menid\nsomething else\n```\n",
        "```console\n$ menid check none.menid\nUsage: ...\n```\n",
        "```console\n$ rm -r x\n```\n",
        "```python\nx = \n```\n",
        "```python\n>>> 1 + 1\n3\n```\n",
        "```fortran\nEND\n```\n",
        "```menid\ndomain a\n",
    ],
)
def test_a_page_that_does_not(try_page: Callable[[str], str], text: str) -> None:
    assert try_page(text) == "fails"
