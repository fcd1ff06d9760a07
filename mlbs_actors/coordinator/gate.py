"""What becomes of a frame: a picture of the scene, the first of another one, or none.

Not in the paper, whose sequences are whole. Frames that show nothing of the scene
(:mod:`mlbs_actors.footage`) are passed over at once: they carry the labels of the last picture, and the next
picture is compared with that one. A frame in which the last picture is not found again waits for the next
frame. If the last picture goes on there, the frame between was damaged; if the frame itself does, a new scene
has begun with it; after ``LONGEST_LOSS`` such frames one has begun in any case. A glare waits as well, and is
a new light in the ``LASTING_LIGHT``-th frame. So a torn or lost frame is decided on one frame later, and a
glare two.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from mlbs_actors.coordinator.matching import Match, Matcher
from mlbs_actors.coordinator.state import CoordinatorState, NewFrame, WaitingFrame
from mlbs_actors.footage.pictures import is_blank, is_still, repeats
from mlbs_actors.messages import FrameStatus

__all__ = [
    "LASTING_LIGHT",
    "LONGEST_LOSS",
    "BeginScene",
    "PassOver",
    "Take",
    "Wait",
    "admitted",
    "passed_over",
]

#: So many frames in a row with a glare are no flash, but have a new light.
LASTING_LIGHT = 3
#: After so many frames in which the last picture is not found, the scene is taken for another one.
LONGEST_LOSS = 5


@dataclass(frozen=True, slots=True)
class PassOver:
    """Have a frame that shows nothing new carry the labels of the last picture."""

    frame_index: int
    status: FrameStatus


@dataclass(frozen=True, slots=True)
class BeginScene:
    """End the epoch; another one begins with a frame."""

    first: NewFrame


@dataclass(frozen=True, slots=True)
class Take:
    """Go on to a picture."""

    new: NewFrame
    match: Match


@dataclass(frozen=True, slots=True)
class Wait:
    """Have a frame wait for the next one."""

    frame: WaitingFrame


def admitted(
    state: CoordinatorState, new: NewFrame, matcher: Matcher, at_rest: bool, concealed: bool
) -> Iterator[PassOver | BeginScene | Take | Wait]:
    """Decide on a frame, and on those that have waited for it.

    Parameters
    ----------
    state : CoordinatorState
        Each decision must be carried out on it before the next one is asked for.
    new : NewFrame
    matcher : Matcher
    at_rest : bool
        Whether nothing moves in the last picture.
    concealed : bool
        Whether the frame is known to be damaged.

    Yields
    ------
    PassOver, BeginScene, Take or Wait
        In the order of the frames.
    """
    waiting = state.epoch.waiting
    nothing = "damaged" if concealed else _nothing_new(state, new, at_rest)
    if nothing is not None:
        yield from passed_over(waiting)
        yield PassOver(new.frame_index, nothing)
        return
    match = matcher.match(state.epoch, new)
    if match.status == "ok":
        yield from passed_over(waiting)
    elif waiting and waiting[-1].lost and _goes_on(state, waiting[-1], new, matcher):
        first = waiting[-1].new
        yield from passed_over(waiting[:-1])
        yield BeginScene(first)
        yield Take(first, matcher.match(state.epoch, first))
        match, waiting = matcher.match(state.epoch, new), ()
    elif match.status == "flash" and len(waiting) + 1 >= LASTING_LIGHT:
        for one in (*(frame.new for frame in waiting), new):
            lit = matcher.match(state.epoch, one, lasting=True)
            yield PassOver(one.frame_index, lit.status) if lit.tracked is None else Take(one, lit)
        return
    if match.lost and state.epoch.lost + 1 >= LONGEST_LOSS:
        yield from passed_over(waiting)
        yield BeginScene(new)
        match, waiting = matcher.match(state.epoch, new), ()
    if match.status == "ok":
        yield Take(new, match)
        return
    if match.status != "flash":
        yield from passed_over(waiting)
    yield Wait(WaitingFrame(new, match.status, match.lost))


def passed_over(waiting: Iterable[WaitingFrame]) -> Iterator[PassOver]:
    """Pass over frames that have waited: the scene goes on without them."""
    for one in waiting:
        yield PassOver(one.frame_index, one.status)


def _nothing_new(state: CoordinatorState, new: NewFrame, at_rest: bool) -> FrameStatus | None:
    """Say why a picture shows nothing new of the scene; None if it may."""
    gray, last = new.picture.gray, state.epoch.picture.gray
    if is_blank(gray, last):
        return "blank"
    seen = is_still if at_rest else repeats
    return "repeated" if not state.epoch.waiting and seen(gray, last) else None


def _goes_on(state: CoordinatorState, waiting: WaitingFrame, new: NewFrame, matcher: Matcher) -> bool:
    """Whether a frame in which the last picture was not found goes on in the next one: a new scene."""
    return matcher.found(waiting.new.picture, new.picture, state.epoch.shape) is not None
