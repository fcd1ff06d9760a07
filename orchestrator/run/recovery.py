"""When a stream that lost a process goes back to its last snapshot, and when it has done so often enough."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MOST_RETURNS", "STALL_SECONDS", "START_SECONDS", "Returns"]

#: Returns in succession that bring a stream no further.
MOST_RETURNS = 3

#: A burst of frames that takes longer than this hangs, s: many times what the slowest machine needs.
STALL_SECONDS = 180.0

#: The same for the first one after a start, which may have to compile everything, on a machine under load.
START_SECONDS = 900.0


@dataclass(frozen=True, slots=True)
class Returns:
    """How often a stream has gone back.

    Attributes
    ----------
    total : int
    in_vain : int
        The last ones, without a label map more than ever before.
    furthest : int
        Label maps that were committed at a loss, at most.
    """

    total: int = 0
    in_vain: int = 0
    furthest: int = 0

    def after_loss(self, committed: int) -> Returns | None:
        """Count one more; None if the stream has gone back often enough.

        Parameters
        ----------
        committed : int
            Label maps committed when the process was lost.
        """
        in_vain = 1 if committed > self.furthest else self.in_vain + 1
        if in_vain > MOST_RETURNS:
            return None
        return Returns(self.total + 1, in_vain, max(self.furthest, committed))

    @property
    def last_try(self) -> bool:
        """Whether another loss without progress is the end."""
        return self.in_vain == MOST_RETURNS
