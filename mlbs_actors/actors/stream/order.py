"""Guard of every part with a state: each frame once and in order."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mlbs_actors.errors import LayerError

__all__ = ["FrameOrder"]


class FrameOrder:
    """Refuses a frame that does not follow the last one, and every frame after a failed one.

    Parameters
    ----------
    last : int
        Frame that was done last, −1 for none.

    Attributes
    ----------
    last : int or None
        As above; None after a frame that failed.

    A call that comes twice, or after one that failed half-way, would leave a state that no undisturbed run
    ever has.
    """

    def __init__(self, last: int = -1) -> None:
        self.last: int | None = last

    @contextmanager
    def step(self, frame: int, *, after: int) -> Iterator[None]:
        """Do the work of ``frame`` in the ``with`` block.

        Parameters
        ----------
        frame : int
            Frame index.
        after : int
            Frame index that must have been done last, −1 for none.

        Raises
        ------
        LayerError
            If another frame was last, or the last one failed.
        """
        if self.last != after:
            last = "a frame that failed" if self.last is None else f"frame {self.last}"
            raise LayerError(
                f"Frame {frame} follows frame {after} but {last} was last; start the stream again."
            )
        self.last = None
        yield
        self.last = frame
