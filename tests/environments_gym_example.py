"""A Gymnasium environment and its translation, for tests; named in settings."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np


class Lamp(gymnasium.Env[int, int]):
    """A lamp that goes on with some chance; when it is on the episode ends."""

    action_space = gymnasium.spaces.Discrete(2)
    observation_space = gymnasium.spaces.Discrete(2)

    def __init__(self, chance: float = 0.7) -> None:
        self.chance = chance
        self.lit = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.lit = 0
        return self.lit, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        if action == 0 and self.np_random.random() < self.chance:
            self.lit = 1
        return self.lit, float(np.float64(self.lit) - 1), bool(self.lit), False, {}


def atoms(env: Any, observation: int) -> list[str]:
    return ["lit"] if observation else []


def action(env: Any, name: str, arguments: tuple[str, ...]) -> int:
    return {"left": 0, "right": 1}[arguments[0]]


def put(env: Any, state: list[str]) -> int:
    env.unwrapped.lit = int("lit" in state)
    return int(env.unwrapped.lit)


def wrong_atoms(env: Any, observation: int) -> list[str]:
    return ["shining"]
