"""The directions of imports, the public names, and what starting up may load."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import menid_plan
from conftest import ROOT

PACKAGE = ROOT / "menid_plan"

# A part may import from itself and from the parts named here.
ALLOWED = {
    "source": set(),
    "errors": {"source"},
    "resources": set(),
    "model": {"source", "errors"},
    "language": {"source", "errors", "resources", "model"},
    "grounding": {"source", "errors", "model"},
    "files": set(),
    "interrupts": set(),
    "compiled": {"files"},
    "charts": {"errors"},
    "experience": {"source", "errors", "model", "grounding", "language"},
    "environments": {"source", "errors", "model", "grounding", "language", "mdp", "experience"}
    | {"files", "compiled"},
    "memory": {"errors"},
    "mdp": {"source", "errors", "model", "grounding", "compiled", "memory"},
    "solving": {"source", "errors", "model", "grounding", "mdp"},
    "simulation": {"errors", "grounding", "mdp", "solving", "memory"},
    "policy": {"errors", "grounding", "mdp", "solving", "simulation"},
    "policy_file": {"errors", "language", "grounding", "model", "solving", "policy"},
    "planning": {"errors", "model", "grounding", "mdp", "solving", "policy", "simulation"},
    "ppddl": {"source", "errors", "resources", "model", "language"},
    "exchange": {
        "charts",
        "source",
        "errors",
        "model",
        "grounding",
        "mdp",
        "solving",
        "policy",
        "files",
    },
    "servers": {"errors", "model", "grounding", "exchange", "experience", "environments"},
    "texts": {"errors", "model", "grounding", "exchange", "planning"},
    "planners": {
        "errors",
        "model",
        "grounding",
        "solving",
        "policy",
        "planning",
        "texts",
        "exchange",
        "environments",
        "servers",
    },
    "allocation": {"errors", "grounding", "mdp", "compiled"},
    "learning": {
        "allocation",
        "charts",
        "source",
        "errors",
        "model",
        "language",
        "grounding",
        "mdp",
        "solving",
        "planning",
        "experience",
        "environments",
        "files",
        "interrupts",
    },
    "report": {
        "charts",
        "errors",
        "model",
        "grounding",
        "mdp",
        "solving",
        "policy",
        "planning",
        "exchange",
        "experience",
        "learning",
    },
    "studies": {
        "allocation",
        "charts",
        "errors",
        "model",
        "grounding",
        "mdp",
        "solving",
        "experience",
        "environments",
    }
    | {"planning", "simulation", "learning"},
    "cli": {
        "source",
        "errors",
        "resources",
        "model",
        "language",
        "grounding",
        "mdp",
        "solving",
        "exchange",
        "ppddl",
        "servers",
        "texts",
        "planners",
        "experience",
        "environments",
        "planning",
        "policy",
        "policy_file",
        "simulation",
        "learning",
        "report",
        "studies",
        "files",
        "interrupts",
        "charts",
    },
}
# Which packages from elsewhere are imported in one place only.
ONLY_IN = {
    "lark": {"menid_plan.language.grammar", "menid_plan.ppddl.syntax"},
    "click": {"menid_plan.cli"},
    "llvmlite": {"menid_plan.compiled"},
    "numba": {"menid_plan.compiled"},
    "rich": {"menid_plan.cli"},
    "matplotlib": {"menid_plan.charts", "menid_plan.exchange.picture"},
    "jinja2": {"menid_plan.report.page"},
    "pybullet": {"menid_plan.environments.hdd"},
    "gymnasium": {"menid_plan.environments.gymnasium"},
    "distributed": {"menid_plan.environments.dask"},
}


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            assert node.module is not None
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def test_every_part_is_placed() -> None:
    parts = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in modules()}
    assert parts - {"__init__"} == set(ALLOWED)


@pytest.mark.parametrize("path", modules(), ids=name_of)
def test_imports_run_one_way(path: Path) -> None:
    name = name_of(path)
    if name == "menid_plan":
        return  # the face of the package hands on names of any part
    own = name.split(".")[1]
    for imported in imports(path):
        parts = imported.split(".")
        assert parts[0] != "menid_solvers", "solvers are found through entry points"
        if parts[0] == "menid_plan" and len(parts) > 1 and parts[1] != "__version__":
            assert parts[1] == own or parts[1] in ALLOWED[own], f"{name} imports {imported}"
        for package, places in ONLY_IN.items():
            if parts[0] == package:
                assert any(name.startswith(place) for place in places), f"{name} imports {package}"


def test_public_names() -> None:
    assert menid_plan.__all__ == [
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
    for name in menid_plan.__all__:
        assert getattr(menid_plan, name).__doc__, f"{name} has no docstring"


def test_check_loads_nothing_heavy() -> None:
    program = (
        "import sys; from click.testing import CliRunner; from menid_plan.cli.main import main;"
        "before = set(sys.modules);"
        "result = CliRunner().invoke(main, ['check', 'domains/hdd/domain.menid']);"
        "assert result.exit_code == 0, result.output;"
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    heavy = {"numpy", "scipy", "networkx", "numba", "pybullet", "rich", "matplotlib", "difflib"}
    assert heavy & set(loaded) == set()
    assert "lark" in loaded


def test_solving_again_loads_machine_code_only() -> None:
    program = (
        "import sys; from click.testing import CliRunner; from menid_plan.cli.main import main;"
        "files = ['domains/hdd/domain.menid', 'domains/hdd/bench.menid'];"
        "result = CliRunner().invoke(main, ['solve', *files]);"
        "assert result.exit_code == 0, result.output;"
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    for _ in range(2):  # the first run may have to compile
        loaded = subprocess.run(
            [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.split()
    assert {"numba", "scipy", "networkx", "rich"} & set(loaded) == set()
    assert {"llvmlite", "numpy"} <= set(loaded)


def test_files_stay_small() -> None:
    # A file of this length is asking to be two.
    long = {
        name_of(path): n for path in modules() if (n := len(path.read_text().splitlines())) > 500
    }
    assert long == {}
