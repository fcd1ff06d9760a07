"""The engine for actors in threads of one process, where nothing has to be loaded in advance."""

from __future__ import annotations

from mlbs_actors.actors.parts import EngineParts

__all__ = ["ColdParts"]


class ColdParts(EngineParts):
    """The engine, without the first steps that make a new process warm."""

    def warm_coordinator(self) -> None:
        """Do nothing."""

    def warm_segmenter(self) -> None:
        """Do nothing."""

    def warm_layer(self) -> None:
        """Do nothing."""
