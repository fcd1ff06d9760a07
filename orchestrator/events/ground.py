"""Where something stands, whether that is in a zone, and to which side of a line it goes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

from mlbs_actors.messages import Region
from mlbs_actors.record.frame_row import ResultRow
from mlbs_actors.record.scene_place import Point
from orchestrator.events.zones import Zone

__all__ = ["crossing", "foot_of", "is_inside", "on_ground"]


def foot_of(region: Region) -> Point:
    """Return where something with this box stands, px: where the middle of its lowest row of pixels is."""
    return region.x + region.width / 2, region.y + region.height - 0.5


def on_ground(region: Region, zone: Zone, result: ResultRow) -> tuple[Point, Sequence[Point]] | None:
    """Return where something stands, and a zone's corners, px; None while the zone's place is unknown."""
    foot = foot_of(region)
    if zone.fixed_to == "picture":
        return foot, zone.corners(result.shape)
    in_first = None if result.scene is None else result.scene.back(foot)
    if result.scene is None or in_first is None:
        return None
    return in_first, zone.corners(result.scene.shape)


def is_inside(point: Point, corners: Sequence[Point]) -> bool:
    """Whether a point is inside a polygon, by the even-odd rule."""
    x, y = point
    inside = False
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            inside = not inside
    return inside


def crossing(start: Point, end: Point, line: Sequence[Point]) -> Literal["left", "right"] | None:
    """Tell to which side of a line a straight way leads.

    Parameters
    ----------
    start, end : (x, y)
        Of the way.
    line : sequence of (x, y)
        At least two points.

    Returns
    -------
    {"left", "right"} or None
        The side on which the way ends, as seen by somebody who looks along the line from its first point;
        None if it crosses the line not at all, or back and forth.
    """
    crossed = [side for a, b in pairwise(line) if (side := _side(start, end, a, b)) is not None]
    return crossed[-1] if len(crossed) % 2 else None


def _side(start: Point, end: Point, a: Point, b: Point) -> Literal["left", "right"] | None:
    # A point on the line belongs to one of its sides, so that each crossing counts once.
    before, after = _turn(a, b, start) >= 0, _turn(a, b, end) >= 0
    if before == after or (_turn(start, end, a) >= 0) == (_turn(start, end, b) >= 0):
        return None
    return "right" if after else "left"  # y points downwards


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
