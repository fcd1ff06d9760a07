"""The events of zones, lines and rules for a program of one's own, which has results instead of a record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, SupportsFloat

from pydantic import ValidationError

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, FrameError
from mlbs_actors.extras import needing
from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.record.frame_row import FrameRow, ResultRow
from mlbs_actors.wording import described
from orchestrator.events.event import Event
from orchestrator.events.rules import Rule
from orchestrator.events.scene import SceneTracker
from orchestrator.events.zones import EventSettings, Minimum, Zone, read_zones
from orchestrator.yaml_file import words_of

__all__ = ["Zones"]


class Zones:
    """Says what happens in zones, at lines and by rules, as a run says it in its events.

    Parameters
    ----------
    zones : sequence of Zone or mapping
        As in a file of zones: ``{"name": "yard", "polygon": [[0, 0.5], [1, 0.5], [1, 1]]}``.
    minimum : Minimum or mapping, optional
        What an object must reach before it has events.
    rules : sequence of Rule or mapping
    frame_rate : float
        Frames a second, from which the time of a result follows unless it is given.
    config : Config, optional
        The subtractor's own, if it has another one than the default: it says for how long an object that is
        out of sight is waited for.

    Raises
    ------
    ConfigError
        If something is not understood; names it.
    MissingPackageError
        Without the extra ``read``.

    Examples
    --------
    >>> zones = Zones([{"name": "yard", "polygon": [[0, 0.5], [1, 0.5], [1, 1], [0, 1]]}], frame_rate=25)
    >>> for frame, result in MultilayerSubtractor().segment("street.mp4"):
    ...     for event in zones.update(result):
    ...         print(event.kind, event.layer, event.zone)
    """

    def __init__(
        self,
        zones: Sequence[Zone | Mapping[str, Any]],
        *,
        minimum: Minimum | Mapping[str, Any] | None = None,
        rules: Sequence[Rule | Mapping[str, Any]] = (),
        frame_rate: float = 25.0,
        config: Config | None = None,
    ) -> None:
        with needing("read"):
            from orchestrator.events.happenings import Happenings
        if not isinstance(frame_rate, SupportsFloat) or not frame_rate > 0:
            raise ConfigError(f"frame_rate is {frame_rate!r}; it must be above 0, in frames a second.")
        for name, given in (("zones", zones), ("rules", rules)):
            if isinstance(given, Mapping | str) or not isinstance(given, Iterable):
                raise ConfigError(f"{name} is {described(given)}; give a list, of one too: {name}=[...].")
        try:
            settings = EventSettings.model_validate(
                {"zones": tuple(zones), "minimum": minimum, "rules": tuple(rules)}
            )
        except ValidationError as invalid:
            raise ConfigError(_words_of(invalid)) from None
        remembered = (config or Config()).layers.dormant_frames
        followed = settings.event_rules(Minimum(), remembered)
        self._frame_rate = frame_rate
        self._happenings = Happenings(followed)
        self._scene = SceneTracker(None, 0, None, 0.0) if followed.of_scene else None
        named = (("zones", settings.zones), ("rules", settings.rules))
        shown = (f"{kind} {', '.join(one.name for one in ones)}" for kind, ones in named if ones)
        self._shown = ", ".join(shown) or "none"

    def __repr__(self) -> str:
        frames = self._happenings.state.rows
        return f"Zones({self._shown}; {self._frame_rate:g} frames/s, frames {frames})"

    @classmethod
    def read(cls, path: str | Path, stream: str, *, frame_rate: float = 25.0) -> Zones:
        """Read the zones and rules of a stream from a file, as ``--zones`` takes it.

        Raises
        ------
        ConfigError
            If it cannot be read, holds anything that is not understood, or does not name the stream.
        """
        file = read_zones(Path(path), "Zones.read")
        if stream not in file.streams:
            named = ", ".join(sorted(file.streams)) or "none"
            raise ConfigError(f"{path} has no zones of a stream {stream!r}; it names {named}.")
        rules = file.rules_of(stream, 0)
        return cls(rules.zones, minimum=rules.minimum, rules=rules.rules, frame_rate=frame_rate)

    def update(
        self,
        result: Segmentation,
        *,
        seconds: float | None = None,
        image: Array | None = None,
        clock: float | None = None,
    ) -> list[Event]:
        """Return what is certain with the next result: three in a row must agree before something is.

        Parameters
        ----------
        result : Result
            All of a stream, one after the other.
        seconds : float, optional
            Its time in the stream, s; by default its frame's number through the frame rate.
        image : (H, W, 3) uint8, optional
            Its frame, BGR, which zones with ``fixed_to="scene"`` need.
        clock : float, optional
            When it was taken, seconds since 1970, for the schedules of rules.

        Raises
        ------
        FrameError
            If it is no result, or not after the last one, or ``image`` is missing or of another size.
        """
        if not isinstance(result, Segmentation):
            raise FrameError(
                f"update takes the result of one frame, not {described(result)}: "
                "for frame, result in subtractor.segment(video): zones.update(result)."
            )
        index, state = result.frame_index, self._happenings.state
        if index < state.rows:
            raise FrameError(
                f"The result of frame {index} came after that of frame {state.rows - 1}; give each result "
                "once, in order."
            )
        pts = index / self._frame_rate if seconds is None else seconds
        place = None
        if self._scene is not None:
            if image is None:
                raise FrameError(
                    "A zone is fixed to the scene, which is found in pictures: give the image, too."
                )
            if image.ndim != 3 or image.shape[:2] != result.labels.shape:
                raise FrameError(
                    f"The image is {described(image)}, the label map {result.labels.shape}; give the frame "
                    "of this result."
                )
            self._scene.after(pts, result, image)
            place = self._scene.place
        row = ResultRow.of(result, 1.0, place)
        return self._happenings.after(FrameRow(index, pts, result.status, row, f"{index:05d}"), clock)

    def end(self) -> list[Event]:
        """Return what is certain as the stream has come to its end: who is in a zone leaves it, and ends.

        A later result of the same stream may follow, but its objects are then born anew. Another stream needs
        zones of its own.
        """
        return self._happenings.end()


def _words_of(invalid: ValidationError) -> str:
    faults = []
    for fault in invalid.errors():
        place = ".".join(map(str, fault["loc"]))
        faults.append(f"{place + ': ' if place else ''}{words_of(fault, EventSettings)}")
    text = "; ".join(faults)
    return f"The zones cannot be used: {text}{'' if text.endswith('?') else '.'}"
