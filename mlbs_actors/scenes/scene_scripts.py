"""The synthetic scenes: contents, and motion of camera and objects. :data:`SCRIPTS` lists them.

Places and lengths are in canvas units (:mod:`mlbs_actors.scenes.stage`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mlbs_actors.messages import Array
from mlbs_actors.scenes.stage import CANVAS, SLOPE, Stage, Surface
from mlbs_actors.scenes.street import balloon, vehicle

__all__ = ["SCRIPTS", "Script", "build_surfaces"]


@dataclass(frozen=True)
class Script:
    """A scene's description in a sentence, and the function that sets it up.

    Attributes
    ----------
    description : str
    set_up : callable
    objects : int, optional
        Default number of objects; None if the scene has a fixed number.
    """

    description: str
    set_up: Callable[[Stage], None]
    objects: int | None = None


def _to_and_fro(time: Array, period: float) -> Array:
    """−1 at time 0, +1 half a period later, at constant speed."""
    return np.abs(((time / period) % 1.0) * 4 - 2) * -1 + 1


def _demo(stage: Stage) -> None:
    time = stage.time
    stage.pan(1.2)
    stage.zoom = 1.0 + 0.05 * np.sin(time / 40)
    stage.background()
    stage.thing(1, (100 * _to_and_fro(time, 120), 62 + 3 * np.sin(time / 9)), (34, 19))
    stage.thing(2, (-105 * _to_and_fro(time, 100), 34 + 2 * np.sin(time / 7)), (27, 17))
    stage.thing(3, (80 * np.cos(time / 15), -62 + 22 * np.sin(time / 11)), (15, 13), rotation=time / 18)


def _street(stage: Stage) -> None:
    time = stage.time
    stage.pan(1.0)
    stage.zoom = 1.0 + 0.03 * np.sin(time / 40)
    stage.street()
    unit = stage.unit
    near = vehicle(stage.texture_rng(), (84, 38), (60, 62, 196), unit, faces_right=True)
    stage.painted(1, near, (95 * _to_and_fro(time, 130), 62.0))
    far = vehicle(stage.texture_rng(), (66, 32), (196, 128, 52), unit)
    stage.painted(2, far, (-100 * _to_and_fro(time, 110), 18.0))
    stage.painted(
        3, balloon(stage.texture_rng(), 17, unit), (75 * np.cos(time / 18), -82 + 10 * np.sin(time / 11))
    )


def _pan(stage: Stage) -> None:
    stage.pan(2.0)
    stage.background()
    stage.thing(1, (-60 + 20 * np.sin(stage.time / 14), 55), (30, 18))
    stage.thing(2, (60, 30 + 12 * np.sin(stage.time / 10)), (20, 24))


def _roll_zoom(stage: Stage) -> None:
    stage.pan(0.6)
    stage.roll = 0.10 * np.sin(stage.time / 13)
    stage.zoom = 1.0 + 0.15 * np.sin(stage.time / 17)
    stage.background()
    stage.thing(1, (70 * _to_and_fro(stage.time, 100), 50), (28, 18))
    stage.thing(2, (50, -40 + 25 * np.sin(stage.time / 9)), (16, 18))


def _crossing(stage: Stage) -> None:
    stage.pan(0.5)
    stage.background()
    stage.thing(1, (75 * _to_and_fro(stage.time, 120), 40), (24, 20))
    stage.thing(2, (-75 * _to_and_fro(stage.time, 120), 50), (26, 22))


def _stop(stage: Stage) -> None:
    stage.x = 25 * np.sin(stage.time / 14)
    stage.y = 4 * np.sin(stage.time / 10)
    stage.background()
    driven = np.minimum(stage.time, min(stage.frames // 2, 55))
    stage.thing(1, (-60 + 2.2 * driven, 50), (28, 18), in_world=True)


def _late_entry(stage: Stage) -> None:
    stage.pan(1.2)
    stage.background()
    stage.thing(1, (-50 + 25 * np.sin(stage.time / 12), 60), (28, 17))
    first, second = min(stage.frames // 4, 40), min(stage.frames // 2, 80)
    stage.thing(2, (np.maximum(205 - 4.0 * np.maximum(stage.time - first, 0), 70), 40), (26, 20))
    stage.thing(3, (np.minimum(-195 + 3.2 * np.maximum(stage.time - second, 0), 0), -50), (20, 16))


def _leave(stage: Stage) -> None:
    stage.pan(1.5)
    stage.background()
    stage.thing(1, (60 + 20 * np.sin(stage.time / 12), 60), (28, 17))
    away = np.maximum(stage.time - min(stage.frames // 4, 40), 0)
    stage.thing(2, (np.maximum(-20 - 3.5 * away, -260), 25), (26, 20))


def _no_mover(stage: Stage) -> None:
    stage.pan(1.8)
    stage.background()


def _static_walker(stage: Stage) -> None:
    stage.background()
    stage.walker(1, (95 * _to_and_fro(stage.time, 220), 30 + 1.2 * np.cos(stage.time * 4 * np.pi / 26)), 95)


def _walker(stage: Stage) -> None:
    stage.pan(1.5)
    stage.background()
    stage.walker(1, (60 * _to_and_fro(stage.time, 180), 30 + 1.2 * np.cos(stage.time * 4 * np.pi / 26)), 95)


def _passer_by(stage: Stage) -> None:
    stage.slope = 0.0
    stage.x = 60 * np.sin(stage.time / 40)
    stage.y = 6 * np.sin(stage.time / 23)
    stage.background()
    walked = 1.6 * stage.time - 130, 20 + 1.2 * np.cos(stage.time * 4 * np.pi / 26)
    stage.walker(1, (walked[0] - stage.x, walked[1] - stage.y), 95)


def _rest(stage: Stage) -> None:
    stage.x = 25 * np.sin(stage.time / 14)
    stage.y = 4 * np.sin(stage.time / 10)
    stage.background()
    start, end = 40, 40 + min(max(stage.frames - 80, 0), 300)
    driven = np.minimum(stage.time, start) + np.maximum(stage.time - end, 0)
    stage.thing(1, (-70 + 2.2 * driven, 50), (28, 18), in_world=True)


def _hidden(stage: Stage) -> None:
    stage.x = 12 * np.sin(stage.time / 17)
    stage.background()
    before, behind = 40, 60
    driven = np.minimum(stage.time, before) + np.maximum(stage.time - before - behind, 0)
    stage.thing(1, (-95 + 2.2 * driven, 30), (24, 17), in_world=True)
    stage.thing(0, (-7, 38), (36, 32), in_world=True)


def _twins(stage: Stage) -> None:
    stage.pan(0.5)
    stage.street()
    car = vehicle(stage.texture_rng(), (66, 32), (196, 128, 52), stage.unit)
    stage.painted(1, car, (90 * _to_and_fro(stage.time, 120), 30.0))
    stage.painted(2, car, (-90 * _to_and_fro(stage.time, 120), 44.0))


def _near_scene(stage: Stage) -> None:
    stage.slope = 2.2 * SLOPE
    stage.pan(1.6)
    stage.y = 2.5 * np.sin(stage.time * 0.45)
    stage.roll = 0.01 * np.sin(stage.time * 0.22)
    stage.background(props=14)


def _camera_stops(stage: Stage) -> None:
    pause = min(stage.frames // 3, 60)
    stage.x = 2.0 * (np.minimum(stage.time, pause) + np.clip(stage.time - 2 * pause, 0, 60))
    stage.background()
    stage.thing(1, (80 * _to_and_fro(stage.time, 130), 55), (28, 18))
    stage.thing(2, (-30, -20 + 40 * _to_and_fro(stage.time, 90)), (18, 22))


def _static_empty(stage: Stage) -> None:
    stage.background()


def _parallax(stage: Stage) -> None:
    stage.slope = 2.2 * SLOPE
    stage.pan(1.6)
    stage.background(props=14)
    stage.thing(1, (25 * np.sin(stage.time / 14), 45), (26, 18))


def _crowd(stage: Stage) -> None:
    """Each object enters from the nearer long side, circles about its place, and leaves again."""
    stage.pan(1.0)
    stage.background(props=3)
    flight = max(min(25, stage.frames // 8), 1)
    for label in range(1, 33):
        column, row = (label * 5) % 8, (label * 5) // 8 % 4
        place = (-140 + 40 * column, -88 + 58.0 * row)
        enters = 0.0 if label == 1 else 0.3 * stage.frames * (label - 1) / 31
        hidden = np.maximum(enters + flight - stage.time, 0) / flight
        hidden = np.maximum(hidden, np.maximum(stage.time - (stage.frames - 1 - enters - flight), 0) / flight)
        if label == 1:
            hidden[:] = 0.0
        outside = np.sign(place[1]) * (155 - abs(place[1])) * np.minimum(hidden, 1.0)
        angle = stage.time * 2 * np.pi / stage.rng.uniform(28, 44) + stage.rng.uniform(0, 2 * np.pi)
        path = (place[0] + 9 * np.cos(angle), place[1] + 9 * np.sin(angle) + outside)
        stage.thing(label, path, (stage.rng.uniform(11, 14), stage.rng.uniform(10, 13)))


def _steady_crowd(stage: Stage) -> None:
    """Each object circles in a cell of its own, so that none hides another, out of step with its
    neighbours: objects that touch and move alike would be one."""
    stage.pan(1.0)
    stage.background(props=3)
    columns, rows = 7, 5
    for label in range(1, stage.objects + 1):
        column, row = divmod(label * 17 % (columns * rows), rows)
        place = CANVAS / columns * (column - columns // 2), 0.75 * CANVAS / rows * (row - rows // 2)
        # Half a circle from left to right, a quarter from top to bottom.
        angle = stage.time * 2 * np.pi / 30 + np.pi / 2 * (2 * column + row)
        stage.thing(label, (place[0] + 6 * np.cos(angle), place[1] + 9 * np.sin(angle)), (16.5, 15.5))


def _traffic(stage: Stage) -> None:
    """Three lanes; in each an object has left before the next one comes."""
    stage.pan(1.2)
    stage.background()
    every, speed, beyond = 75, 3.5, CANVAS / 2 + 45
    lanes = ((62.0, 1.0), (20.0, -1.0), (-45.0, 1.0))
    for number in range(max(1, stage.frames // every)):
        height, direction = lanes[number % len(lanes)]
        driven = np.clip(speed * (stage.time - every * number) - beyond, -beyond, beyond)
        size = (stage.rng.uniform(22, 30), stage.rng.uniform(14, 19))
        stage.thing(number + 1, (direction * driven, height + 2 * np.sin(stage.time / 9)), size)


def _small_object(stage: Stage) -> None:
    stage.pan(1.4)
    stage.background()
    stage.thing(1, (80 * _to_and_fro(stage.time, 110), 15), (11, 8))


#: Every scene by name.
SCRIPTS: dict[str, Script] = {
    "demo": Script("moving camera; three objects, two of which pass each other", _demo),
    "street": Script("a street: two cars that pass each other, a balloon; the camera follows", _street),
    "pan": Script("panning camera; two objects that go along with it", _pan),
    "roll-zoom": Script("camera that rolls ±6° and zooms ±15 %; two objects", _roll_zoom),
    "crossing": Script("two equally fast objects meet; one hides the other, again and again", _crossing),
    "stop": Script("an object moves and then stops for good; the camera sways", _stop),
    "late-entry": Script("one object from the start, a second and a third enter later", _late_entry),
    "leave": Script("two objects, one of which leaves", _leave),
    "no-mover": Script("moving camera and parallax, nothing else moves", _no_mover),
    "static-walker": Script("still camera; one walker with swinging arms and legs", _static_walker),
    "walker": Script("panning camera; one walker with swinging arms and legs", _walker),
    "passer-by": Script("turning camera, no parallax; a walker crosses the scene", _passer_by),
    "rest": Script("an object drives, rests for up to 300 frames, and goes on; the camera sways", _rest),
    "hidden": Script("an object stays behind a rock for 60 frames and comes out again", _hidden),
    "twins": Script("two cars that look alike pass each other, again and again", _twins),
    "near-scene": Script(
        "strong parallax and many near bushes under a walking camera, nothing moves", _near_scene
    ),
    "camera-stops": Script("the camera stops and goes on; two objects move all the time", _camera_stops),
    "static-empty": Script("still camera, nothing moves: only sensor noise", _static_empty),
    "parallax": Script("strong parallax and many near bushes; one object", _parallax),
    "crowd": Script("objects come and go: 1, then 32, then 1", _crowd),
    "traffic": Script("one object after the other drives through the picture", _traffic),
    "steady-crowd": Script(
        "objects of 1 % of the picture each, all there all the time; objects=N of them", _steady_crowd, 8
    ),
    "small-object": Script("one object of about 280 px (at 320×240)", _small_object),
}


def build_surfaces(
    name: str, frames: int, rng: np.random.Generator, width: int, height: int, objects: int | None = None
) -> tuple[Surface, ...]:
    """Set a scene up.

    Parameters
    ----------
    name : str
        A key of :data:`SCRIPTS`.
    frames : int
    rng : numpy Generator
        For textures and outlines.
    width, height : int
        Size of the picture, px.
    objects : int, optional
        Number of objects, for a scene without a fixed number.

    Returns
    -------
    tuple of Surface
        Back to front.
    """
    script = SCRIPTS[name]
    stage = Stage(frames, rng, width, height, objects or script.objects or 0)
    script.set_up(stage)
    return stage.surfaces()
