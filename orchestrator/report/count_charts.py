"""Charts of what was counted in a stream, as inline SVG: bars by the hour, and where objects stood."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from markupsafe import Markup

from orchestrator.counts.stream_counts import Heat
from orchestrator.report.pictures import StripPicture

__all__ = ["PlaceChart", "heat_chart", "place_charts"]

_HOURS = 24
_WIDTH, _HEIGHT, _STEP = 900, 90, 36  # of a chart, and of an hour in it; units of the SVG

#: Columns of the table that are drawn of a place, and what they are called.
_BARS = {
    "picture": (("born", "born"),),
    "zone": (("entered", "entered"),),
    "line": (("crossed_left", "to the left"), ("crossed_right", "to the right")),
}
_COLOURS = ("#4c8dff", "#e08a2e")

_SVG = Markup('<svg viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>')
_BAR = Markup('<rect x="{}" y="{}" width="{}" height="{}" fill="{}"><title>{}</title></rect>')
_TEXT = Markup('<text x="{}" y="{}" class="middle">{}</text>')
_CELL = Markup('<rect x="{}" y="{}" width="1.03" height="1.03" fill="hsl({} 95% 50%)" fill-opacity="{}"/>')
_PICTURE = Markup('<image href="{}" width="{}" height="{}" preserveAspectRatio="none" opacity="0.5"/>')


@dataclass(frozen=True, slots=True)
class PlaceChart:
    """A chart of one place.

    Attributes
    ----------
    title : str
        The place and its sums.
    drawing : Markup
    """

    title: str
    drawing: Markup


def place_charts(rows: Sequence[Mapping[str, str]]) -> list[PlaceChart]:
    """Draw the last day of every place; see :func:`orchestrator.counts.stream_counts.recent_hours`."""
    places: dict[str, list[Mapping[str, str]]] = {}
    for row in rows:
        if row["kind"] in _BARS:
            places.setdefault(row["place"], []).append(row)
    return [_place_chart(name or "whole picture", of_place) for name, of_place in places.items()]


def _place_chart(name: str, rows: Sequence[Mapping[str, str]]) -> PlaceChart:
    last = _hour(rows[-1])
    rows = [row for row in rows if _hour(row) > last - _HOURS]
    columns = _BARS[rows[-1]["kind"]]
    most = max(1, *(sum(int(row[column] or 0) for column, _ in columns) for row in rows))
    bars = []
    for row in rows:
        x, foot = (_HOURS - 1 - last + _hour(row)) * _STEP + 20, float(_HEIGHT)
        for (column, words), colour in zip(columns, _COLOURS, strict=False):
            number = int(row[column] or 0)
            height = round((_HEIGHT - 8) * number / most, 1)
            foot -= height
            bars.append(_BAR.format(x, foot, _STEP - 6, height, colour, f"{_words(row)}: {number} {words}"))
        bars.append(_TEXT.format(x + _STEP // 2 - 3, _HEIGHT + 16, _short(row)))
    sums = ", ".join(f"{words} {sum(int(row[column] or 0) for row in rows)}" for column, words in columns)
    label = f"{name} by the hour: {sums}; at most {most} an hour"
    return PlaceChart(f"{name}: {sums}", _SVG.format(_WIDTH, _HEIGHT + 22, label, Markup("").join(bars)))


def heat_chart(heat: Heat, picture: StripPicture | None) -> Markup:
    """Draw in how many label maps an object stood in each cell, over a picture if there is one."""
    width, height = (16, 9) if picture is None else (picture.width, picture.height)
    tall = round(heat.columns * height / width, 2)
    most = math.log1p(max(heat.label_maps))
    cells = []
    for cell, number in enumerate(heat.label_maps):
        if number:
            share = math.log1p(number) / most  # a few seconds should be seen beside an hour
            place = cell % heat.columns, cell // heat.columns
            cells.append(_CELL.format(*place, round(55 - 55 * share), round(0.25 + 0.6 * share, 2)))
    scaled = Markup('<g transform="scale(1 {})">{}</g>').format(
        round(tall / heat.rows, 4), Markup("").join(cells)
    )
    below = "" if picture is None else _PICTURE.format(picture.data, heat.columns, tall)
    label = f"Cells in which objects stood: {len(cells)} of {len(heat.label_maps)}"
    return _SVG.format(heat.columns, tall, label, below + scaled)


def _hour(row: Mapping[str, str]) -> int:
    return int(row["hour"]) if row["hour"] else int(datetime.fromisoformat(_begins(row)).timestamp()) // 3600


def _begins(row: Mapping[str, str]) -> str:
    return row["begins"].replace("Z", "+00:00")


def _words(row: Mapping[str, str]) -> str:
    return f"hour {row['hour']}" if row["hour"] else row["local"][:16].replace("T", " ")


def _short(row: Mapping[str, str]) -> str:
    return row["hour"] or row["local"][11:16]
