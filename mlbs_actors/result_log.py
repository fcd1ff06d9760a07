"""The package's logger, and what it is told of results: new scenes, lost motion of the camera, objects."""

from __future__ import annotations

import logging

from mlbs_actors.messages import FrameStatus
from mlbs_actors.result import Result

__all__ = ["LOGGER", "ResultLog"]

#: It has no handler of its own, so that a warning is seen on standard error unless the program has set up
#: logging.
LOGGER = logging.getLogger("mlbs_actors")


class ResultLog:
    """Logs what is new with each result of a stream."""

    def __init__(self) -> None:
        self._shape: tuple[int, ...] | None = None
        self._status: FrameStatus | None = None

    def note(self, result: Result) -> None:
        """Log what is new with the next result."""
        index, shape = result.frame_index, result.labels.shape
        if self._shape not in (None, shape):
            LOGGER.info("frame %d: %d×%d px, so all begins anew", index, shape[1], shape[0])
        if result.status == "cut":
            LOGGER.info("frame %d: a cut, another scene begins", index)
        elif result.status == "untracked" and self._status != "untracked":
            LOGGER.info("frame %d: the camera's motion is lost", index)
        elif result.status == "ok" and self._status == "untracked":
            LOGGER.info("frame %d: the camera's motion is found again", index)
        if result.born or result.ended:
            LOGGER.debug("frame %d: born %s, ended %s", index, list(result.born), list(result.ended))
        self._shape, self._status = shape, result.status
