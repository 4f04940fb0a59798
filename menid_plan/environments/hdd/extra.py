"""What the scenes need that is installed with the extra `hdd`."""

from __future__ import annotations

from importlib.util import find_spec

from menid_plan.environments.interface import EnvironmentFailedError

MODULES = ("pybullet", "manifold3d", "fast_simplification", "trimesh")


def require() -> None:
    """Raise EnvironmentFailedError, which names the extra to install, if something is missing."""
    missing = [name for name in MODULES if find_spec(name) is None]
    if missing:
        raise EnvironmentFailedError(
            f"the hard-drive scenes need {', '.join(missing)}: pip install 'menid-plan[hdd]'"
        )
