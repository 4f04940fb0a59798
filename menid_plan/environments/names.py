"""Functions that a run file names: ``package.module:function``, or ``file.py:function``."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from typing import Any

from menid_plan.environments.session import said
from menid_plan.environments.settings import SettingError


def named(text: str, key: str, folder: Path) -> Any:
    """What a name in a run file stands for; importing it runs its module's code.

    A file's name starts from ``folder``. Raises SettingError for ``key``.
    """
    module_name, colon, attribute = text.rpartition(":")
    if not colon or not module_name or not attribute:
        raise SettingError(
            key, f"expected `package.module:function` or `file.py:function`, not `{text}`"
        )
    try:
        if module_name.endswith(".py"):
            found: Any = _from_file((folder / module_name).resolve())
        else:
            found = importlib.import_module(module_name)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:  # whatever a module does when it is imported
        raise SettingError(key, f"`{text}`: {said(error)}") from error
    return found


def _from_file(path: Path) -> Any:
    name = f"menid_run_{path.stem}_{abs(hash(path)):x}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"`{path}` is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    folder = str(path.parent)
    sys.path.insert(0, folder)  # as if it were run: it may import what is beside it
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        if folder in sys.path:
            sys.path.remove(folder)
    return module
