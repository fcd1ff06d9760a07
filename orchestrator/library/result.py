"""What a program gets for a frame of a stream."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mlbs_actors.extras import needing
from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.result import shown_objects
from mlbs_actors.source import SourceFrame

with needing("run"):
    import pyarrow

__all__ = ["StreamResult"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamResult(Segmentation):
    """The result of one frame of a stream.

    Besides the attributes of :class:`~mlbs_actors.messages.Segmentation` it has these. Pickled it is small,
    as its label map is compressed.

    Attributes
    ----------
    stream : str
        The stream's name.
    frame : int
        Number of the frame in its source, from 0, with those that have no label map.
    time : float
        Of the frame in its source, s.
    name : str
        The frame's, as in the names of its files.
    """

    stream: str
    frame: int
    time: float
    name: str

    def __repr__(self) -> str:
        height, width = self.labels.shape
        place = f"{self.stream}, frame {self.frame}, {self.time:.2f} s"
        return f"StreamResult({place}, {width}×{height}{shown_objects(self)})"

    def _repr_html_(self) -> str:
        """Show the label map and a row for each object, in a notebook."""
        from mlbs_actors.pictures.notebook import result_as_html

        return result_as_html(self, f"{self.stream}, frame {self.frame}, {self.time:.2f} s")

    @classmethod
    def of(cls, segmentation: Segmentation, frame: SourceFrame, stream: str) -> StreamResult:
        """Add to a label map where it comes from; what only the engine needs of it is left out."""
        values: dict[str, Any] = {one.name: getattr(segmentation, one.name) for one in fields(Segmentation)}
        nothing = np.zeros((0, 0), np.int8)
        values |= {"normaliser": nothing.view(np.uint8), "fallback": nothing}
        return cls(**values, stream=stream, frame=frame.index, time=frame.pts, name=frame.name)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the label map compressed."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        labels = np.ascontiguousarray(values.pop("labels"))
        packed = pyarrow.compress(labels.data.cast("B"), codec="lz4", asbytes=True)
        return _unpacked, (values, packed, labels.shape, labels.dtype.str)


def _unpacked(values: dict[str, Any], packed: bytes, shape: tuple[int, int], kind: str) -> StreamResult:
    size = shape[0] * shape[1] * np.dtype(kind).itemsize
    pixels = pyarrow.decompress(packed, decompressed_size=size, codec="lz4", asbytes=True)
    labels: Array = np.frombuffer(pixels, kind).reshape(shape)
    return StreamResult(labels=labels, **values)
