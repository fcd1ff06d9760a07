"""How the last picture goes on in a new one: the flow between them, and the new light.

Where most of the picture looks alike and the light is nearly the same, that is one search for the flow. Where
not, a second one looks everywhere, and if the light is new, a third one from the last picture in that light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.flow.estimate import Picture
from mlbs_actors.footage.continuity import LEAST_FOUND, SURELY_ALIKE, Likeness, found_again
from mlbs_actors.footage.light import light_change, matched_places, relit, saturates, strength
from mlbs_actors.messages import Array

__all__ = ["Continuation", "continuation"]

#: Up to this, grey levels, the light changes little by little; by more it jumps.
SMALL_CHANGE = 12.0


@dataclass(frozen=True, slots=True)
class Continuation:
    """How a picture goes on in the next one.

    Attributes
    ----------
    flow : DenseFlow
    alike : Likeness
        Of the two pictures along the flow.
    found : bool
        Whether it does at all.
    whole : bool
        Whether it does nearly everywhere.
    light : (3, 256) or (0, 256) uint8
        :func:`~mlbs_actors.footage.light.light_change`.
    gray : (h, w) uint8
        The last picture's grey levels in the new light.
    glaring : bool
        Whether the light has jumped so far that much is cut off: it may be a flash.
    """

    flow: DenseFlow
    alike: Likeness
    found: bool
    whole: bool
    light: Array
    gray: Array
    glaring: bool


def continuation(
    before: Picture,
    picture: Picture,
    search: Callable[[Picture, bool], DenseFlow],
) -> Continuation:
    """Find the last picture again in a new one.

    Parameters
    ----------
    before, picture : Picture
        The last one and the new one.
    search : callable
        Returns the flow to the new picture from another one; whether to look closely everywhere.

    Returns
    -------
    Continuation
    """
    flow = search(before, False)
    alike = Likeness.along(flow, before.gray, picture.gray)
    light, gray_light, glaring = _light(before, picture, flow)
    found, whole = LEAST_FOUND, alike.share() >= SURELY_ALIKE
    if not whole or strength(gray_light) > SMALL_CHANGE:
        closely = search(before, True)
        found = found_again(closely, Likeness.along(closely, before.gray, picture.gray))
        if found < LEAST_FOUND:
            gray_light = light_change(before.gray.reshape(-1, 1), picture.gray.reshape(-1, 1))
        if gray_light.size:
            lit = _relit_gray(before.gray, gray_light)
            anew = search(replace(before, gray=lit), True)
            alike_anew = Likeness.along(anew, lit, picture.gray)
            found_anew = found_again(anew, alike_anew)
            if found_anew > found:
                flow, alike, found = anew, alike_anew, found_anew
                light, gray_light, glaring = _light(before, picture, flow)
    gray = _relit_gray(before.gray, gray_light)
    return Continuation(flow, alike, found >= LEAST_FOUND, whole, light, gray, glaring)


def _light(before: Picture, picture: Picture, flow: DenseFlow) -> tuple[Array, Array, bool]:
    """How the colours and the grey levels have changed, and whether much of them is cut off."""
    places, there = matched_places(flow)
    old, new = before.colours.reshape(-1, 3)[places], picture.colours.reshape(-1, 3)[there]
    light = light_change(old, new)
    gray_light = light_change(before.gray.reshape(-1, 1)[places], picture.gray.reshape(-1, 1)[there])
    return light, gray_light, strength(light) > SMALL_CHANGE and saturates(old, light)


def _relit_gray(gray: Array, change: Array) -> Array:
    lit: Array = relit(gray[..., None], change)[..., 0]
    return lit
