"""The internals of a stream for rerun: trajectories, motion fields and posteriors of every layer.

No record contains them; they are computed again from the source (:mod:`orchestrator.export.replay`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import rerun
import rerun.blueprint as rrb

from mlbs_actors.inspection import LayerInspection
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.motion_field.node_grid import node_positions
from mlbs_actors.pictures.layer_colours import layer_colour
from mlbs_actors.wording import count_of
from orchestrator.export.replay import InspectedFrame

__all__ = ["Written", "layer_rgb", "layout", "write_internals"]

#: Arrows of a motion field along the longer side of the picture.
_ARROWS = 40

_BACKGROUND_RGB = (160, 160, 160)

_KINDS = ("trajectories", "motion_fields", "posteriors")


@dataclass(frozen=True, slots=True)
class Written:
    """Summary of the frames logged.

    Attributes
    ----------
    frames : int
    others : int
        Frames whose label map differs from the record.
    layers : tuple of int
        Ascending, the background's included.
    """

    frames: int
    others: int
    layers: tuple[int, ...]

    def remarks(self, name: str, expected: int) -> list[str]:
        """Describe missing and differing frames; ``expected`` is the number of recorded frames."""
        sentences = []
        if self.frames < expected:
            sentences.append(
                f"The source of stream {name!r} gave {self.frames} of its {count_of(expected, 'frame')} "
                "again; there are no internals of the others."
            )
        if self.others:
            sentences.append(
                f"{count_of(self.others, 'label map')} of stream {name!r} came out other than recorded, by "
                "other packages, another kind of CPU or a changed source (see run.json); the internals are "
                "those of the new ones."
            )
        return sentences


def write_internals(recording: rerun.RecordingStream, name: str, frames: Iterable[InspectedFrame]) -> Written:
    """Log these entities on the timelines ``frame`` and ``time``; in full-size pixels, 0 is the background.

    ===========================  ======================================================================
    ``NAME/trajectories/ID``     the layer's points, ``…/steps`` from each one's position before
    ``NAME/motion_fields/ID``    its motion t−1 → t, arrows on a coarse grid
    ``NAME/posteriors/ID``       posterior of each pixel before the graph cut, 255 is certain
    ===========================  ======================================================================

    Parameters
    ----------
    recording : rerun.RecordingStream
    name : str
        Of the stream.
    frames : iterable of InspectedFrame
    """
    seen: set[int] = set()
    shown: set[int] = set()
    made, others = 0, 0
    for frame in frames:
        recording.set_time("frame", sequence=frame.recorded.index)
        recording.set_time("time", duration=frame.recorded.pts)
        present = {layer.layer for layer in frame.inspection.layers}
        for gone in sorted(shown - present):  # else the viewer keeps showing its last state
            for kind in _KINDS:
                recording.log(_path(name, kind, gone), rerun.Clear(recursive=True))
        shown = present
        seen |= present
        size = _Size((frame.recorded.height, frame.recorded.width), frame.inspection.shape)
        for layer in frame.inspection.layers:
            _write_layer(recording, name, layer, size)
        made += 1
        others += not frame.same_labels
    return Written(made, others, tuple(sorted(seen)))


def layout(layers: Mapping[str, Iterable[int]]) -> rrb.Blueprint:
    """Lay out one tab per stream: over the picture its results, trajectories and motion fields, and
    posteriors.

    Parameters
    ----------
    layers : mapping of str to iterable of int
        Stream → the layers that have a posterior.
    """
    tabs = []
    for name, ids in layers.items():
        stream = rerun.new_entity_path([name])
        shown = {"results": "labels layers", "trajectories": "trajectories", "motion fields": "motion_fields"}
        views = [
            rrb.Spatial2DView(
                origin=stream,
                contents=["$origin/image", *(f"$origin/{part}/**" for part in parts.split())],
                name=title,
            )
            for title, parts in shown.items()
        ]
        posteriors = [
            rrb.Spatial2DView(origin=_path(name, "posteriors", layer), name=f"posterior of {layer}")
            for layer in ids
        ]
        tabs.append(rrb.Grid(*views, rrb.Tabs(*posteriors), name=name))
    return rrb.Blueprint(rrb.Tabs(*tabs))


@dataclass(frozen=True, slots=True)
class _Size:
    """Maps processed pixels, (H, W), to those of the recorded picture."""

    recorded: tuple[int, int]
    worked: tuple[int, int]

    @property
    def _scale(self) -> Array:
        return np.array(self.recorded[::-1], np.float32) / np.array(self.worked[::-1], np.float32)

    def points(self, points: Array) -> Array:
        """Map positions (…, 2); a pixel's is its centre's."""
        return np.asarray((points + np.float32(0.5)) * self._scale - np.float32(0.5))

    def vectors(self, vectors: Array) -> Array:
        """Scale displacements (…, 2)."""
        return np.asarray(vectors * self._scale)

    def picture(self, picture: Array) -> Array:
        """Resize a map of the whole picture."""
        if self.worked == self.recorded:
            return picture
        return np.asarray(cv2.resize(picture, self.recorded[::-1], interpolation=cv2.INTER_LINEAR))


def _write_layer(recording: rerun.RecordingStream, name: str, layer: LayerInspection, size: _Size) -> None:
    colour = layer_rgb(layer.layer)
    here = size.points(layer.positions)
    before = size.points(layer.positions + layer.motions)
    points = _path(name, "trajectories", layer.layer)
    recording.log(points, rerun.Points2D(here, colors=colour, radii=rerun.Radius.ui_points(1.5)))
    steps = rerun.LineStrips2D(np.stack([before, here], axis=1), colors=colour)
    recording.log(f"{points}/steps", steps)
    origins, vectors = _arrows(layer, max(size.worked) / _ARROWS)
    arrows = rerun.Arrows2D(origins=size.points(origins), vectors=size.vectors(vectors), colors=colour)
    recording.log(_path(name, "motion_fields", layer.layer), arrows)
    posterior = np.zeros(size.worked, np.uint8)
    if layer.layer == BACKGROUND:
        posterior[:] = 255  # where no object is near
    posterior[layer.region.slices] = np.rint(255 * layer.posterior)
    _, png = cv2.imencode(".png", size.picture(posterior))
    image = rerun.EncodedImage(contents=png.tobytes(), media_type="image/png")
    recording.log(_path(name, "posteriors", layer.layer), image)


def _arrows(layer: LayerInspection, spacing: float) -> tuple[Array, Array]:
    """Return origins and forward motions (n, 2) at nodes of a motion field, about ``spacing`` px apart."""
    field, home = layer.motion_field, layer.home
    step = max(1, round(spacing / field.spacing))
    rows, columns = (np.arange(min(step, count) // 2, count, step) for count in field.mean.shape[:2])
    nodes = node_positions(field.shape, field.spacing)[np.ix_(rows, columns)].reshape(-1, 2)
    motions = field.mean[np.ix_(rows, columns)].reshape(-1, 2)
    return nodes + np.array([home.x, home.y], np.float32), -motions


def _path(name: str, kind: str, layer: int) -> str:
    return str(rerun.new_entity_path([name, kind, str(layer)]))


def layer_rgb(layer: int) -> tuple[int, int, int]:
    """Return the colour of a layer as in the overlay, grey for the background."""
    if layer == BACKGROUND:
        return _BACKGROUND_RGB
    blue, green, red = layer_colour(layer)
    return red, green, blue
