"""Charts of a stream over time as inline SVG: no script, and legible in light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from mlbs_actors.messages import Array
from mlbs_actors.pictures.layer_colours import layer_colour
from orchestrator.report.history import StageTimes, StreamHistory, frame_ranges
from orchestrator.sinks.object_list import SeenObject

__all__ = ["css_colour", "object_count_chart", "stage_chart", "timeline_chart"]

_WIDTH, _LEFT, _RIGHT = 900, 60, 36  # of every chart, and margins for its labels; units of the SVG
_ROW, _PLOT, _AXIS = 18, 150, 42  # heights: a layer's row, a plot, the frame numbers and seconds below
_TICK_LABEL = 40  # least distance of two numbers below
_POINTS = 240  # of a curve: longer streams are averaged

_LINE = Markup('<line x1="{}" y1="{}" x2="{}" y2="{}" class="{}"/>')
_TEXT = Markup('<text x="{}" y="{}" class="{}">{}</text>')
_AREA = Markup('<path d="{}" fill="{}" class="area"/>')
_SVG = Markup('<svg viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>')


@dataclass(frozen=True, slots=True)
class _FrameAxis:
    """The horizontal axis of frames, with the seconds that some of them come at."""

    first: int
    last: int
    history: StreamHistory

    def x(self, frame: float) -> float:
        """Return where a frame begins; the last one ends at the right edge."""
        share = (frame - self.first) / (self.last + 1 - self.first)
        return round(float(_LEFT + share * (_WIDTH - _LEFT - _RIGHT)), 1)

    def drawn(self, top: float) -> Markup:
        """Draw the numbers below a chart that ends at ``top``."""
        frames = [tick for tick in _round_numbers(self.first, self.last) if tick == int(tick)]
        pts = self.history.pts
        marks = [
            _LINE.format(self.x(tick), top, self.x(tick), top + 4, "axis")
            + _TEXT.format(self.x(tick), top + 18, "middle", f"{tick:.0f}")
            for tick in frames
        ]
        free_from = 0.0  # seconds of a gap lie close together
        for tick in _round_numbers(float(pts[0]), float(pts[-1])):
            x = self.x(float(np.interp(tick, pts, self.history.frames)))
            if x >= free_from:
                marks.append(_TEXT.format(x, top + 34, "middle", f"{tick:g}"))
                free_from = x + _TICK_LABEL
        return (
            _LINE.format(_LEFT, top, _WIDTH - _RIGHT, top, "axis")
            + Markup("").join(marks)
            + _TEXT.format(_LEFT - 8, top + 18, "end", "frame")
            + _TEXT.format(_LEFT - 8, top + 34, "end", "s")
        )


def css_colour(layer: int) -> str:
    """Return a layer's colour in CSS."""
    blue, green, red = layer_colour(layer)
    return f"#{red:02x}{green:02x}{blue:02x}"


def timeline_chart(history: StreamHistory, lives: Sequence[SeenObject]) -> Markup:
    """Draw a row a layer: a bar while it is seen, hollow while it rests, a line while not, how it ends.

    At the top are lost frames, and those that are no ordinary picture.
    """
    axis = _axis(history)
    rows: list[Markup] = []
    top = 0
    for title, kind, statuses in (("lost", "lost", history.lost), ("footage", "unusual", history.unusual)):
        if not statuses:
            continue
        rows.append(_TEXT.format(_LEFT - 8, top + _ROW - 5, "end", title))
        bar = Markup('<rect x="{}" y="{}" width="{}" height="{}" class="{}"><title>{}</title></rect>')
        for status, frames in statuses:
            for first, last in frame_ranges(frames):
                width = max(axis.x(last + 1) - axis.x(first), 1.5)
                said = f"{status}: frames {first} to {last}"
                rows.append(bar.format(axis.x(first), top + 3, width, _ROW - 6, kind, said))
        top += _ROW
    bar = Markup(
        '<rect x="{}" y="{}" width="{}" height="{}" rx="2" fill="{}" class="bar"><title>{}</title></rect>'
    )
    for life in lives:
        middle = top + _ROW / 2
        rows.append(_TEXT.format(_LEFT - 8, top + _ROW - 5, "end", life.layer))
        rows.append(
            _LINE.format(axis.x(life.spans[0][0]), middle, axis.x(life.spans[-1][1] + 1), middle, "hidden")
        )
        for first, last in life.spans:
            title = (
                f"object {life.layer}: frames {first} to {last}, "
                f"{history.seconds_at(first):.2f} s to {history.seconds_at(last):.2f} s"
            )
            width = max(axis.x(last + 1) - axis.x(first), 1.5)
            rows.append(bar.format(axis.x(first), top + 3, width, _ROW - 6, css_colour(life.layer), title))
        rest = Markup('<rect x="{}" y="{}" width="{}" height="{}" class="rest"><title>{}</title></rect>')
        for first, last in history.rests.get(life.layer, ()):
            title = f"object {life.layer} rests: frames {first} to {last}"
            width = max(axis.x(last + 1) - axis.x(first), 1.5)
            rows.append(rest.format(axis.x(first), top + 6, width, _ROW - 12, title))
        rows.append(_TEXT.format(axis.x(life.spans[-1][1] + 1) + 4, top + _ROW - 5, "", life.ending.sign))
        top += _ROW
    label = f"When each of {len(lives)} objects was seen; the table of objects says the same."
    return _SVG.format(_WIDTH, top + _AXIS, label, Markup("").join(rows) + axis.drawn(top))


def object_count_chart(history: StreamHistory) -> Markup:
    """Draw the number of objects over the frames."""
    positions, counts = _averaged(history.frames, history.objects[None])
    label = (
        f"Objects in a frame over frames {history.frames[0]} to {history.frames[-1]}: "
        f"{history.objects.min()} to {history.objects.max()}."
    )
    return _plot(_axis(history), positions, counts, ["#4c8dff"], label, "objects")


def stage_chart(history: StreamHistory, stages: Sequence[StageTimes], colours: Sequence[str]) -> Markup:
    """Draw the stacked times of the stages over the frames."""
    positions, times = _averaged(history.frames, np.stack([stage.by_frame for stage in stages]))
    label = "Milliseconds of each stage over the frames; the table of stages has the means."
    return _plot(_axis(history), positions, times, colours, label, "ms")


def _axis(history: StreamHistory) -> _FrameAxis:
    lost = [frame for _, frames in history.lost for frame in frames]
    frames = [*history.frames[[0, -1]].tolist(), *lost]
    return _FrameAxis(min(frames), max(frames), history)


def _plot(
    axis: _FrameAxis, positions: Array, values: Array, colours: Sequence[str], label: str, unit: str
) -> Markup:
    """Stack areas of values (k, n) at positions (n,)."""
    heights = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    top = max(float(heights.max()), 1.0)
    y = np.round(8 + (_PLOT - 8) * (1 - heights / top), 1)
    x = [axis.x(position + 0.5) for position in positions]
    areas = []
    for lower, upper, colour in zip(y, y[1:], colours, strict=False):
        there = [f"{left},{height}" for left, height in zip(x, upper.tolist(), strict=True)]
        back = [f"{left},{height}" for left, height in zip(x, lower.tolist(), strict=True)]
        areas.append(_AREA.format("M" + "L".join(there + back[::-1]) + "Z", colour))
    grid = []
    for tick in _round_numbers(0, top, 4):
        height = round(8 + (_PLOT - 8) * (1 - tick / top), 1)
        grid.append(_LINE.format(_LEFT, height, _WIDTH - _RIGHT, height, "grid"))
        grid.append(_TEXT.format(_LEFT - 8, height + 4, "end", f"{tick:g} {unit}" if tick else "0"))
    content = Markup("").join(grid + areas) + axis.drawn(_PLOT)
    return _SVG.format(_WIDTH, _PLOT + _AXIS, label, content)


def _averaged(frames: Array, values: Array) -> tuple[Array, Array]:
    """Average values (k, n) over frames (n,) to at most :data:`_POINTS`."""
    pieces = np.array_split(np.arange(len(frames)), min(len(frames), _POINTS))
    positions = np.array([frames[piece].mean() for piece in pieces])
    return positions, np.stack([values[:, piece].mean(axis=1) for piece in pieces], axis=1)


def _round_numbers(low: float, high: float, most: int = 8) -> list[float]:
    """Return multiples of 1, 2 or 5 × 10ⁿ from ``low`` to ``high``, at most about ``most``."""
    coarse = max(high - low, 1e-9) / most
    power = 10.0 ** np.floor(np.log10(coarse))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if step >= coarse * 0.999)
    return [float(tick) for tick in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step]
