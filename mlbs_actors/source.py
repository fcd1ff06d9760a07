"""What a source of frames delivers, and the reader that delivers it.

Two counts of frames exist. A *source index* (``SourceFrame.index``) counts every frame the source
has, those without a picture too, and is what the record calls a frame. A *frame index* of the engine
(``Segmentation.frame_index``) counts the frames the engine was given, without gaps. They are the same
until the first frame whose status is not ``"ok"``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from mlbs_actors.messages import Array
from mlbs_actors.pickling import pickled_by_values

__all__ = [
    "FrameReader",
    "GapStatus",
    "SourceFrame",
    "SourcePosition",
    "SourceSilence",
    "SourceStatus",
]

#: Why a frame of the record has no label map.
GapStatus = Literal["dropped", "gap", "quarantined"]

#: Status of a frame from the source.
SourceStatus = Literal["ok", GapStatus]


@pickled_by_values
@dataclass(frozen=True, slots=True)
class SourceFrame:
    """One frame as its source delivered it.

    Attributes
    ----------
    index : int
        Source index, from 0 and without gaps; every status counts.
    image : (H, W, 3) uint8, optional
        BGR picture; None exactly when ``status`` is not ``"ok"``.
    pts : float
        Time of presentation, seconds from the source's first frame.
    name : str
        File name of the frame's mask, without extension.
    status : {"ok", "quarantined", "dropped", "gap"}
        ``"quarantined"``: the frame exists but could not be decoded. ``"dropped"``: a camera sent it but
        there was no time for it. ``"gap"``: no frame but a time, beginning at ``pts``, in which a camera sent
        none, or none that is left. These never reach the engine, only the record.
    original : (H', W', 3) uint8, optional
        The picture before its reader shrunk it, for the record; None if ``image`` is that.
    length : int, optional
        Number of frames as the source states it, for the user; None if unknown. It may be wrong.
    pixel_aspect : float
        How wide a pixel is to be shown for its height.
    concealed : bool
        Whether the decoder made up part of the picture. It is labelled as the picture before.
    taken : float, optional
        When a camera took it, by this machine's clock, seconds since 1970; None of a file.
    """

    index: int
    image: Array | None
    pts: float
    name: str
    status: SourceStatus = "ok"
    original: Array | None = None
    length: int | None = None
    pixel_aspect: float = 1.0
    concealed: bool = False
    taken: float | None = None


@dataclass(frozen=True, slots=True)
class SourceSilence:
    """There is no frame at present; ask again.

    Attributes
    ----------
    state : {"stalled", "reconnecting"}, optional
        None if that is normal.
    reason : str, optional
        A sentence for the user, without credentials.
    """

    state: Literal["stalled", "reconnecting"] | None
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class SourcePosition:
    """How far a stream has read its source.

    Attributes
    ----------
    rows : int
        Frames and gaps so far.
    pts : float
        Time of the last one, seconds from the source's first frame.
    time : float
        Wall clock time at which it was taken, seconds since 1970.
    """

    rows: int = 0
    pts: float = 0.0
    time: float = 0.0


class FrameReader(Protocol):
    """An open source, in the reader process."""

    @property
    def problem(self) -> str | None:
        """Damage of the source so far, as a sentence, or None.

        Complete once :meth:`read` has returned None.
        """

    def read(self) -> SourceFrame | SourceSilence | None:
        """Return the next frame, or None at the end (and ever after).

        A camera always answers soon: with a :class:`SourceSilence` if it has sent nothing.

        Raises
        ------
        SourceError
            If the source cannot be read at all. Damage after the first frame is no error: the reader returns
            None and reports it in :attr:`problem`.
        """

    def close(self) -> None:
        """Release the source; may be called twice."""
