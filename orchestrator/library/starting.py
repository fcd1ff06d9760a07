"""Puts the run of a program together, as the command does with its own."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, overload

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from orchestrator.credentials import mask
from orchestrator.events.zones import ZonesFile
from orchestrator.ignored import Ignored
from orchestrator.library.result import StreamResult
from orchestrator.library.session import present_ray
from orchestrator.option_values import LEAST_SIDE, SAVABLE
from orchestrator.options import Arguments
from orchestrator.run.argument_streams import argument_address, argument_streams
from orchestrator.run.listed_stream import ListedStream, check_name

if TYPE_CHECKING:
    import ray
    from typing_extensions import Unpack

    from orchestrator.library.run import Run

__all__ = ["listed_stream", "start"]

#: Sources, with the names of their streams or without.
Sources: TypeAlias = "Mapping[str, str | Path] | Iterable[str | Path]"


class _Settings(TypedDict, total=False):
    """Arguments of :func:`start` that have no bearing on the type of what it returns."""

    address: str | None
    config: Config | None
    output: str | Path | None
    save: Collection[str]
    max_frames: int | None
    max_side: int | None


@overload
def start(
    streams: Sources = (), *, references: Literal[False] = False, **settings: Unpack[_Settings]
) -> Run[StreamResult]: ...


@overload
def start(
    streams: Sources = (), *, references: Literal[True], **settings: Unpack[_Settings]
) -> Run[ray.ObjectRef[StreamResult]]: ...


def start(
    streams: Sources = (),
    *,
    address: str | None = None,
    config: Config | None = None,
    output: str | Path | None = None,
    save: Collection[str] = (),
    max_frames: int | None = None,
    max_side: int | None = None,
    references: bool = False,
) -> Run[Any]:
    """Start streams on Ray, and return at once; their results come from the run, as it is iterated.

    They run in the Ray session of this program, if it has one, else on the cluster at ``address``, else in a
    session of their own on this machine. Streams beyond what fits wait for the others to end.

    Parameters
    ----------
    streams : mapping of str to str, or iterable of str
        Sources by the names of their streams: a video, a folder of images, the URI of a camera or scene.
        Sources without names get the name of their file; of a folder of videos each is a stream.
    address : str, optional
        Of a Ray cluster to join, ``HOST:PORT`` or ``auto``.
    config : Config, optional
        Parameters, from :func:`mlbs_actors.load_config`.
    output : str or Path, optional
        Folder of the run's record, which must not hold one; on a cluster all nodes must see it. By default it
        is temporary, and holds only what streams need to go on after a loss.
    save : collection of str
        What is written there: any of masks, parquet, overlay, background, cutouts.
    max_frames : int, optional
        Each stream ends after so many label maps.
    max_side : int, optional
        Longest side of the pictures that are processed, px; results have full size.
    references : bool
        Whether the run yields references to its results instead.

    Returns
    -------
    Run
        Yields a :class:`~orchestrator.library.result.StreamResult`, or a reference to one in Ray's object
        store, for every label map.

    Raises
    ------
    ConfigError
        If something of this cannot be used; nothing was started.
    MlbsError
        If Ray does not start.
    """
    if unknown := sorted(set(save) - set(SAVABLE)):
        raise ConfigError(f"save holds {unknown[0]!r}; it may hold {', '.join(SAVABLE)}.")
    if output is not None and "://" in str(output):
        raise ConfigError(
            f"output is {mask(str(output))}; give a folder of this machine. Only the command publishes to an "
            "object store."
        )
    for name, number, least in (("max_frames", max_frames, 1), ("max_side", max_side, LEAST_SIDE)):
        if number is not None and number < least:
            raise ConfigError(f"{name} is {number}; it must be at least {least}.")
    listed = _listed(streams)
    with ExitStack() as session:
        if output is None:
            output = session.enter_context(TemporaryDirectory(prefix="mlbs-actors-run-"))
        folder = Path(output).resolve()
        arguments = Arguments(
            output=folder,
            address=address,
            save=frozenset(save),
            max_frames=max_frames,
            max_side=max_side,
            ignore=Ignored({}),
            zones=ZonesFile(),
        )
        shared = session.enter_context(present_ray(address))
        # Imported here, because it imports Ray, whose settings have to be made before.
        from orchestrator.library.run import Run

        run: Run[Any] = Run(
            listed, arguments, config or Config(), session, shared=shared, references=references
        )
        return run


def listed_stream(name: str, source: str | Path) -> ListedStream:
    """Check a stream's name and source; raises ConfigError."""
    try:
        check_name(name, given=True)
        return ListedStream(name, argument_address(str(source)), None)
    except ConfigError as error:
        text = str(error).rstrip(".")
        raise ConfigError(f"{text[0].upper()}{text[1:]}.") from None


def _listed(streams: Sources) -> tuple[ListedStream, ...]:
    if isinstance(streams, str | Path):
        streams = [streams]
    if isinstance(streams, Mapping):
        return tuple(listed_stream(name, source) for name, source in streams.items())
    return argument_streams([str(source) for source in streams])
