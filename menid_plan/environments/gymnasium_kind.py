"""Any Gymnasium environment as an environment of a domain, with functions that translate."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from menid_plan.environments.atoms import Vocabulary, state_texts
from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.environments.names import named
from menid_plan.environments.registry import Place
from menid_plan.environments.settings import SettingError
from menid_plan.errors import MeaningError
from menid_plan.grounding.state import GroundAction, State

Atoms = Callable[[Any, Any], Iterable[str]]
ToAction = Callable[[Any, str, tuple[str, ...]], Any]
Put = Callable[[Any, list[str]], Any]


@dataclass(frozen=True, slots=True)
class GymnasiumKind:
    """Executes actions in a Gymnasium environment.

    ``id`` is what Gymnasium knows it by, or ``make`` a function that makes one; ``arguments`` are
    handed to either. ``atoms(env, observation)`` gives the atoms that hold, as texts.
    ``action(env, name, arguments)`` gives Gymnasium's action. ``put(env, atoms)``, if there is one,
    puts it into a state and gives the observation. These functions are named as
    ``package.module:function``, or as ``file.py:function`` with a file beside the run file. Without
    ``reward`` its rewards are not used.
    """

    name: ClassVar[str] = "gymnasium"
    promise: ClassVar[str] = "a Gymnasium environment, with functions to atoms and from actions"
    needs: ClassVar[str] = "gymnasium>=1"

    atoms: str
    action: str
    id: str = ""
    make: str = ""
    put: str = ""
    arguments: Mapping[str, object] = field(default_factory=dict)
    reward: bool = True

    def __post_init__(self) -> None:
        if bool(self.id) == bool(self.make):
            raise SettingError("id", "expected either `id` or `make`")

    def build(self, place: Place) -> GymnasiumEnvironment:
        """Import what is named and make the environment."""
        try:
            import gymnasium
        except ImportError as error:
            raise EnvironmentFailedError(
                "this kind needs Gymnasium: pip install 'menid-plan[gymnasium]'"
            ) from error
        atoms: Atoms = named(self.atoms, "atoms", place.folder)
        action: ToAction = named(self.action, "action", place.folder)
        put: Put | None = named(self.put, "put", place.folder) if self.put else None
        if self.make:
            env = named(self.make, "make", place.folder)(**self.arguments)
        else:
            try:
                arguments: dict[str, Any] = dict(self.arguments)
                env = gymnasium.make(self.id, **arguments)
            except (gymnasium.error.Error, TypeError) as error:
                raise SettingError("id", f"`{self.id}`: {error}") from error
        vocabulary = Vocabulary(place.domain, place.problem)
        return GymnasiumEnvironment(env, atoms, action, put, vocabulary, reward=self.reward)


class GymnasiumEnvironment:
    """A Gymnasium environment behind three functions."""

    def __init__(
        self,
        env: Any,
        atoms: Atoms,
        action: ToAction,
        put: Put | None,
        vocabulary: Vocabulary,
        *,
        reward: bool,
    ) -> None:
        self._env = env
        self._atoms, self._action, self._put = atoms, action, put
        self._vocabulary = vocabulary
        self._reward = reward
        self._state: State = frozenset()
        self._over = "it was not reset"

    @property
    def capabilities(self) -> Capabilities:
        """Only with a function that puts it into states can it be put into any."""
        spec = getattr(self._env, "spec", None)
        repeatable = spec is None or not getattr(spec, "nondeterministic", False)
        return Capabilities(
            reset_to_any=self._put is not None, repeatable=repeatable, note=str(self._env)[:200]
        )

    def reset(self, state: State | None, seed: int) -> State:
        """Reset it with the seed, then put it into the state."""
        # Gymnasium leaves open how large a seed may be; NumPy's oldest generators take 32 bits.
        observation, _ = self._env.reset(seed=seed % 2**32)
        self._state, self._over = self._seen(observation), ""
        if state is None or state == self._state:
            return self._state
        if self._put is None:
            raise CannotResetError("without `put` it can't be put into a state of choice")
        self._state = self._seen(self._put(self._env, state_texts(state)))
        return self._state

    def execute(self, action: GroundAction) -> Execution:
        """One step; EnvironmentFailedError if the episode is over."""
        if self._over:
            raise EnvironmentFailedError(self._over)
        chosen = self._action(self._env, action.action, action.arguments)
        observation, reward, terminated, truncated, _ = self._env.step(chosen)
        self._state = self._seen(observation)
        if terminated or truncated:
            self._over = "the episode is over, and it was not reset"
        return Execution(self._state, float(reward) if self._reward else None)

    def state(self) -> State:
        """The state after the last step."""
        return self._state

    def close(self) -> None:
        """Close it."""
        self._env.close()

    def _seen(self, observation: Any) -> State:
        try:
            return self._vocabulary.state(self._atoms(self._env, observation))
        except MeaningError as error:
            raise EnvironmentFailedError(f"`atoms` gives {error}") from error
