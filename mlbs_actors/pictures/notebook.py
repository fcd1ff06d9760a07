"""A result as a notebook shows it: a small picture of the label map, and a row for each object."""

from __future__ import annotations

from base64 import b64encode
from html import escape

import cv2
import numpy as np

from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.pictures.layer_colours import layer_colour

__all__ = ["label_colours", "result_as_html"]

#: Longer side of the picture, px, and rows of the table.
_SIDE, _ROWS = 320, 20

_COLUMNS = ("id", "x, y, width, height", "px", "px/frame", "state", "score")

_BACKGROUND = (40, 40, 40)


def label_colours(labels: Array) -> Array:
    """Paint a label map, (H, W) uint16, in the colours of its ids: (H, W, 3) uint8 BGR."""
    painted = np.full((*labels.shape, 3), _BACKGROUND, np.uint8)
    for layer in np.unique(labels[labels > 0]).tolist():
        painted[labels == layer] = layer_colour(layer)
    return painted


def result_as_html(result: Segmentation, frame: str) -> str:
    """Return the HTML of the result of a frame that has this name, with its picture in it."""
    height, width = result.labels.shape
    share = min(1.0, _SIDE / max(height, width))
    size = (max(1, round(width * share)), max(1, round(height * share)))
    small = cv2.resize(result.labels, size, interpolation=cv2.INTER_NEAREST)
    png = cv2.imencode(".png", label_colours(small))[1].tobytes()
    rows = [
        f'<tr><td style="border-left: 1em solid {_css_colour(one.layer)}">{one.layer}</td>'
        f"<td>{', '.join(map(str, one.region.box))}</td><td>{one.area}</td>"
        f"<td>{one.velocity[0]:.1f}, {one.velocity[1]:.1f}</td><td>{one.state}</td>"
        f"<td>{one.score:.2f}</td></tr>"
        for one in result.layers[:_ROWS]
    ]
    if len(result.layers) > _ROWS:
        rows.append(f"<tr><td colspan=6>and {len(result.layers) - _ROWS} more</td></tr>")
    head = "".join(f"<th>{name}</th>" for name in _COLUMNS)
    return (
        f"<div>{escape(frame)}, {width}×{height}, {result.status}</div>"
        f'<img alt="label map" src="data:image/png;base64,{b64encode(png).decode("ascii")}">'
        f"<table><tr>{head}</tr>{''.join(rows)}</table>"
    )


def _css_colour(layer: int) -> str:
    blue, green, red = layer_colour(layer)
    return f"rgb({red}, {green}, {blue})"
