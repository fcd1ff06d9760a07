"""What a user of the engine in one process gets for a frame: the label map, and which objects come and go."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from mlbs_actors.messages import Segmentation

__all__ = ["Result", "shown_objects"]


def shown_objects(result: Segmentation) -> str:
    """Write the status, unless it is the usual one, and the ids of a result."""
    objects = " ".join(str(one.layer) for one in result.layers) or "none"
    status = "" if result.status == "ok" else f", {result.status}"
    return f"{status}, objects {objects}"


@dataclass(frozen=True, slots=True)
class Result(Segmentation):
    """The result of one frame.

    Besides the attributes of :class:`~mlbs_actors.messages.Segmentation` it has these.

    Attributes
    ----------
    tag : object
        What was given to ``apply`` with this frame; None if nothing was.
    born : tuple of int
        Ids that no result before this one has had.
    absent : tuple of int
        Ids that earlier results had and this one does not, but later ones may: of objects that are hidden,
        or too few of whose points are followed.
    ended : tuple of int
        Ids that earlier results had and no later one will. Each is named once, as soon as that is certain:
        some frames after the object was seen last. Those still there at the end of the stream are not named.
    """

    tag: Any = None
    born: tuple[int, ...] = ()
    absent: tuple[int, ...] = ()
    ended: tuple[int, ...] = ()

    def __repr__(self) -> str:
        height, width = self.labels.shape
        changes = (("born", self.born), ("absent", self.absent), ("ended", self.ended))
        changed = "".join(f", {word} {' '.join(map(str, ids))}" for word, ids in changes if ids)
        return f"Result(frame {self.frame_index}, {width}×{height}{shown_objects(self)}{changed})"

    def _repr_html_(self) -> str:
        """Show the label map and a row for each object, in a notebook."""
        from mlbs_actors.pictures.notebook import result_as_html

        return result_as_html(self, f"frame {self.frame_index}")

    @classmethod
    def of(cls, segmentation: Segmentation, tag: object, known: set[int], possible: set[int]) -> Result:
        """Add to a label map what it changes.

        Parameters
        ----------
        segmentation : Segmentation
            As it is published.
        tag : object
        known : set of int
            Ids in earlier results that have not ended; brought up to date.
        possible : set of int
            Ids that a later frame may have.
        """
        shown = {one.layer for one in segmentation.layers}
        born, missing = shown - known, known - shown
        ended = missing - possible
        known |= born
        known -= ended
        values: dict[str, Any] = {one.name: getattr(segmentation, one.name) for one in fields(Segmentation)}
        return cls(
            **values,
            tag=tag,
            born=tuple(sorted(born)),
            absent=tuple(sorted(missing - ended)),
            ended=tuple(sorted(ended)),
        )
