"""Label maps drawn over pictures: the same colour for an id in every picture."""

from mlbs_actors.pictures.drawing import Outline, draw_box, draw_caption, draw_labels, draw_outlines
from mlbs_actors.pictures.layer_colours import layer_colour
from mlbs_actors.pictures.notebook import label_colours

__all__ = [
    "Outline",
    "draw_box",
    "draw_caption",
    "draw_labels",
    "draw_outlines",
    "label_colours",
    "layer_colour",
]
