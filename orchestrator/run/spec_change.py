"""What is to become of a run's streams: what a watched list, or a program, has the driver do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from mlbs_actors.actors.stream.protocol import StreamSpec

__all__ = ["SpecChange"]


@dataclass(frozen=True, slots=True)
class SpecChange:
    """What is to become of a run's streams.

    Attributes
    ----------
    added : tuple of StreamSpec
        New ones.
    removed : tuple of str
        Names of those to end.
    renamed : mapping of str to (str, callable)
        New ones that may be added only when another one has ended, which is told by the call.
    reopened : tuple of StreamSpec
        Cameras that are read from another place.
    restarted : tuple of StreamSpec
        Those to go on with other processes, as they are now.
    configured : tuple of (StreamSpec, object)
        How others are to start from now on, and what their records are to follow at once.
    """

    added: tuple[StreamSpec, ...] = ()
    removed: tuple[str, ...] = ()
    renamed: Mapping[str, tuple[str, Callable[[], None]]] = field(default_factory=dict)
    reopened: tuple[StreamSpec, ...] = ()
    restarted: tuple[StreamSpec, ...] = ()
    configured: tuple[tuple[StreamSpec, object], ...] = ()
