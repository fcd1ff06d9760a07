"""Restarts of a stream after losses: how many, and when to give up."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MOST_RETURNS", "STALL_SECONDS", "START_SECONDS", "Returns"]

#: Most successive returns without progress.
MOST_RETURNS = 3

#: A burst of frames that takes longer than this hangs, s: many times the time of the slowest machine.
STALL_SECONDS = 180.0

#: The same for the first one after a start, which may have to compile everything, on a machine under load.
START_SECONDS = 900.0


@dataclass(frozen=True, slots=True)
class Returns:
    """Count of a stream's returns to its snapshot.

    Attributes
    ----------
    total : int
    in_vain : int
        The most recent ones without further progress.
    furthest : int
        Most label maps committed at a loss.
    """

    total: int = 0
    in_vain: int = 0
    furthest: int = 0

    def after_loss(self, committed: int) -> Returns | None:
        """Count one more; None if the stream is to be given up.

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
        """Whether another loss without progress ends the stream."""
        return self.in_vain == MOST_RETURNS
