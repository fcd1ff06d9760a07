"""Messages within one process, made like those that arrive from another one."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from mlbs_actors.messages.evidence import FrameEvidence
from mlbs_actors.messages.posterior import LayerPosterior
from mlbs_actors.messages.segmentation import Segmentation

__all__ = ["readonly"]

Message = TypeVar("Message", FrameEvidence, LayerPosterior, Segmentation)


def readonly(message: Message) -> Message:
    """Return a message with read-only arrays.

    Arrays that arrive from another process are read-only. Within one process they are made so, too, as Numba
    compiles kernels separately for writable and read-only arrays.
    """
    views: dict[str, Any] = {}
    for one in fields(message):
        value = getattr(message, one.name)
        if isinstance(value, np.ndarray):
            views[one.name] = value.view()
            views[one.name].setflags(write=False)
    return replace(message, **views)
