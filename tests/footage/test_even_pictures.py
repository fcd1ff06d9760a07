"""Plain sheets, nights and skies are scenes like others, and only what has lost its scene is blank."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from mlbs_actors import MultilayerSubtractor, Result
from mlbs_actors.footage.pictures import is_blank
from mlbs_actors.messages import Array

SHAPE = (240, 320)
FRAMES = 36
NOTHING = np.zeros((0, 0), np.uint8)


def beetles(frame: int) -> Array:
    """Plain dark beetles: the colour of a shadow on the sheet."""
    labels = np.zeros(SHAPE, np.uint8)
    for one in range(3):
        place = (30 + 40 * one + (3 + one) * frame, 60 + 60 * one)
        cv2.ellipse(labels, place, (16, 9), 0, 0, 360, one + 1, -1)
    return labels


def lights(frame: int) -> Array:
    labels = np.zeros(SHAPE, np.uint8)
    for one in range(2):
        height = round(90 + 70 * one + 20 * np.sin(frame / 12 + one))
        cv2.circle(labels, (40 + 70 * one + 4 * frame, height), 9, one + 1, -1)
    return labels


def pictures(draw: Callable[[int], Array], ground: int, thing: int, frames: int) -> list[Array]:
    """As a codec gives them, which changes nothing where nothing moves, not even the noise."""
    noise, made = np.random.default_rng(5).normal(0, 1, (*SHAPE, 1)), []
    for frame in range(frames):
        picture = np.where(draw(frame)[..., None] > 0, thing, ground).repeat(3, axis=2).astype(np.float32)
        made.append(np.clip(cv2.GaussianBlur(picture, (0, 0), 0.8) + noise, 0, 255).astype(np.uint8))
    return made


def labelled(frames: list[Array]) -> list[Result]:
    subtractor = MultilayerSubtractor()
    return [result for frame in frames for result in subtractor.apply(frame)] + subtractor.flush()


@pytest.mark.parametrize(
    ("draw", "ground", "thing"), [(beetles, 230, 45), (lights, 12, 230)], ids=["sheet", "night"]
)
def test_plain_things_on_plain_ground_are_found(
    draw: Callable[[int], Array], ground: int, thing: int
) -> None:
    results = labelled(pictures(draw, ground, thing, FRAMES))
    assert {result.status for result in results} == {"ok"}
    for result in results[FRAMES // 2 :]:
        found, true = result.labels > 0, draw(result.frame_index) > 0
        assert 2 * (found & true).sum() >= 0.8 * (found.sum() + true.sum())
        things = [result.labels[draw(result.frame_index) == one] for one in range(1, draw(0).max() + 1)]
        assert len({int(np.bincount(one).argmax()) for one in things} - {0}) == len(things)


def test_an_even_place_that_everything_has_left_shows_nothing_from_then_on() -> None:
    results = labelled(pictures(lambda frame: beetles(4 * frame), 230, 45, FRAMES))
    assert beetles(4 * (FRAMES - 8)).max() == 0
    assert results[2].labels.any()
    assert not results[-1].labels.any()


def even(level: int, structure: float) -> Array:
    gray = np.full((100, 100), level, np.uint8)
    gray.reshape(-1)[: round(structure * gray.size)] = 255 - level
    return gray


@pytest.mark.parametrize(
    ("gray", "before", "blank"),
    [
        (even(0, 0.0), NOTHING, True),
        (even(0, 0.01), NOTHING, False),
        (even(0, 0.0), even(100, 0.5), True),
        (even(0, 0.01), even(100, 0.5), True),  # all but a clock is gone
        (even(0, 0.03), even(100, 0.5), False),
        (even(230, 0.01), even(230, 0.01), False),
        (even(230, 0.0), even(230, 0.01), False),
        (even(200, 0.01), even(230, 0.01), False),  # the light has changed
        (even(0, 0.0), even(230, 0.01), True),
    ],
)
def test_a_picture_is_blank_if_it_has_lost_what_was_there(gray: Array, before: Array, blank: bool) -> None:
    assert is_blank(gray, before) == blank
