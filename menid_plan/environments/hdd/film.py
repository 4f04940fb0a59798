"""Pictures of an execution: frames with a caption, written as GIF, MP4 or PNG."""

from __future__ import annotations

import io
import math
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.environment import HddEnvironment, View
from menid_plan.environments.hdd.scene import Scene
from menid_plan.environments.hdd.shake import PIVOT
from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.grounding.state import GroundAction, State, state_text

Picture = NDArray[np.uint8]

FORMATS = ("gif", "mp4", "png")
WIDTH, HEIGHT = 480, 352  # multiples of 16, as videos want them
BAR = 48  # pixels for the caption
RATE = 20.0  # pictures for each second
LINGER = 1.0  # seconds that the last picture stays
STRIP = 6  # pictures side by side in a PNG


@dataclass(slots=True)
class Camera:
    """Takes pictures of a scene while time passes in it."""

    view: View
    pictures: list[Picture] = field(default_factory=list)
    times: list[float] = field(default_factory=list)

    def __call__(self, scene: Scene) -> None:
        """Take a picture, if it is time for the next one."""
        now, last = scene.world.time, self.times[-1] if self.times else -1.0
        if now < last or now >= last + 1 / RATE - 1e-9:
            self.take(scene)

    def take(self, scene: Scene) -> None:
        """Take a picture now."""
        angle, rise = math.radians(self.view.direction), math.radians(self.view.elevation)
        away = np.array(
            [math.cos(angle) * math.cos(rise), math.sin(angle) * math.cos(rise), math.sin(rise)]
        )
        # A drive that is shaken stands still in its own frame: there it is the camera that turns.
        turn = Rotation.from_euler("x", -scene.frame_angle)
        middle = np.array(self.view.middle)
        eye = PIVOT + turn.apply(middle + self.view.distance * away - PIVOT)
        middle = PIVOT + turn.apply(middle - PIVOT)
        self.pictures.append(
            scene.world.picture(eye, middle, turn.apply([0, 0, 1]), WIDTH, HEIGHT - BAR)
        )
        self.times.append(scene.world.time)


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """The pictures of an execution, (height, width, 3) each, the state after it, and its title."""

    pictures: list[Picture]
    state: State


def film(environment: HddEnvironment, action: GroundAction, state: State | None, seed: int) -> Film:
    """Execute an action before a camera. Where the computation is repeated, the last one is shown."""
    environment.reset(state, seed)
    before = environment.state()
    camera = Camera(environment.view(action))
    environment.drawn = True
    environment.after_step = camera
    try:
        after = environment.execute(action).state
    finally:
        environment.drawn = False
        environment.after_step = None
    # A computation that is repeated begins at time 0 again.
    start = max(k for k, t in enumerate(camera.times) if k == 0 or t < camera.times[k - 1])
    pictures, times = camera.pictures[start:], camera.times[start:]
    # What atoms hold is known of a board at rest.
    atoms = [f"before: {state_text(before)}"] * (len(times) - 1) + [f"after: {state_text(after)}"]
    captioned = [
        _captioned(picture, f"{action}   {t:.2f} s", each)
        for picture, t, each in zip(pictures, times, atoms, strict=True)
    ]
    return Film(captioned, after)


def shown(
    environment: HddEnvironment, action: GroundAction, state: State | None, seed: int
) -> State:
    """Execute an action in PyBullet's window, no faster than it would happen; the state after it."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise EnvironmentFailedError(
            "there is no screen (DISPLAY is not set): write a file instead"
        )
    environment.reset(state, seed)
    begin = time.perf_counter()

    def wait(scene: Scene) -> None:
        time.sleep(max(begin + scene.world.time - time.perf_counter(), 0.0))

    environment.window, environment.after_step = True, wait
    try:
        return environment.execute(action).state
    finally:
        environment.window, environment.after_step = False, None


def _captioned(picture: Picture, title: str, atoms: str) -> Picture:
    """The picture with a bar of text above it."""
    from PIL import Image, ImageDraw, ImageFont

    canvas = Image.new("RGB", (WIDTH, HEIGHT), (255, 255, 255))
    canvas.paste(Image.fromarray(picture), (0, BAR))
    pen = ImageDraw.Draw(canvas)
    pen.text((10, 4), title, fill=(20, 20, 20), font=ImageFont.load_default(17))
    pen.text((10, 26), atoms, fill=(90, 90, 90), font=ImageFont.load_default(14))
    return np.asarray(canvas, np.uint8)


def encoded(found: Film, kind: str) -> bytes:
    """The film as the content of a file: ``gif``, ``mp4``, or ``png`` with some of its pictures."""
    import imageio.v3 as iio

    if kind == "png":
        stream = io.BytesIO()
        chosen = np.linspace(0, len(found.pictures) - 1, STRIP).round().astype(int)
        rows = [
            np.hstack([found.pictures[k] for k in chosen[row : row + STRIP // 2]])
            for row in (0, STRIP // 2)
        ]
        iio.imwrite(stream, np.vstack(rows), extension=".png")
        return stream.getvalue()
    last: Sequence[Picture] = [found.pictures[-1]] * round(LINGER * RATE)
    frames = np.stack([*found.pictures, *last])
    if kind == "gif":
        written: bytes = iio.imwrite(
            "<bytes>", frames, extension=".gif", duration=1000 / RATE, loop=0
        )
        return written
    # The encoder writes to files only.
    with tempfile.TemporaryDirectory(prefix="menid-film-") as folder:
        path = Path(folder) / "film.mp4"
        try:
            iio.imwrite(path, frames, fps=RATE, codec="libx264")
        except (OSError, RuntimeError) as error:
            raise EnvironmentFailedError(f"the video could not be written: {error}") from error
        return path.read_bytes()
