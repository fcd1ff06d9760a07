"""Puts the run of a program together, as the command does with its own."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from contextlib import ExitStack
from os import PathLike, fspath
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, overload

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, SourceError
from orchestrator.credentials import mask
from orchestrator.events.zones import ZonesFile
from orchestrator.ignored import Ignored
from orchestrator.library.result import StreamResult
from orchestrator.library.session import present_ray
from orchestrator.option_values import LEAST_SIDE, SAVABLE
from orchestrator.options import Arguments
from orchestrator.run.argument_streams import argument_address, argument_streams
from orchestrator.run.listed_stream import ListedStream, check_name
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_list import missing_sources
from orchestrator.sources.presence import require_source

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
        What is written to ``output``, which must be given then: any of masks, parquet, overlay, background,
        cutouts.
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
        If something of this cannot be used, or a file is not there; nothing was started.
    MlbsError
        If Ray does not start.
    """
    _check_config(config)
    _check_output(output, save)
    for name, number, least in (("max_frames", max_frames, 1), ("max_side", max_side, LEAST_SIDE)):
        _check_number(name, number, least)
    listed = _listed(streams)
    with ExitStack() as session:
        if output is None:
            output = session.enter_context(TemporaryDirectory(prefix="mlbs-actors-run-"))
        folder = RunFolder(Path(output).resolve(), "output=")
        folder.refuse_if_used([stream.name for stream in listed])
        arguments = Arguments(
            output=folder.path,
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
            listed, folder, arguments, config or Config(), session, shared=shared, references=references
        )
        return run


def listed_stream(name: str, source: str | Path) -> ListedStream:
    """Check a stream's name and source; raises ConfigError."""
    if not isinstance(name, str):
        raise ConfigError(f"A stream is named {name!r}; give its name as text.")
    try:
        check_name(name, given=True)
        stream = ListedStream(name, argument_address(_text_of(source)), None)
        require_source(stream.source)
    except (ConfigError, SourceError) as error:
        text = str(error)
        raise ConfigError(
            f"{text[0].upper()}{text[1:].rstrip('.')}{'' if text[-1] == '?' else '.'}"
        ) from None
    return stream


def _listed(streams: Sources) -> tuple[ListedStream, ...]:
    if isinstance(streams, str | Path):
        streams = [streams]
    if isinstance(streams, Mapping):
        return tuple(listed_stream(name, source) for name, source in streams.items())
    if not isinstance(streams, Iterable):
        raise ConfigError(f"streams is {streams!r}; give a list of sources, or a dict by their names.")
    listed = argument_streams([_text_of(source) for source in streams])
    for reason in missing_sources(listed).values():
        raise ConfigError(reason)
    return listed


def _text_of(source: str | Path) -> str:
    if not isinstance(source, str | PathLike):
        raise ConfigError(
            f"A source is {source!r}; give a path or an address as text, such as 'street.mp4' or 'rtsp://…'."
        )
    return fspath(source)


def _check_config(config: object) -> None:
    if config is not None and not isinstance(config, Config):
        raise ConfigError(f"config is {config!r}; it must be a Config: load it with mlbs_actors.load_config.")


def _check_output(output: str | Path | None, save: Collection[str]) -> None:
    if isinstance(save, str):
        raise ConfigError(f"save is one word, {save!r}; give a list: [{save!r}].")
    if unknown := sorted(set(map(str, save)) - set(SAVABLE)):
        raise ConfigError(f"save holds {unknown[0]!r}; it may hold {', '.join(SAVABLE)}.")
    if output is None:
        if save:
            raise ConfigError(f"save is {list(save)}, but nothing would be left: give output, a folder, too.")
        return
    if not isinstance(output, str | PathLike):
        raise ConfigError(f"output is {output!r}; give the path of a folder.")
    if "://" in str(output):
        raise ConfigError(
            f"output is {mask(str(output))}; give a folder of this machine. Only the command publishes to an "
            "object store."
        )


def _check_number(name: str, number: object, least: int) -> None:
    if number is None:
        return
    if not isinstance(number, int):
        raise ConfigError(f"{name} is {number!r}; it must be a whole number, at least {least}.")
    if number < least:
        raise ConfigError(f"{name} is {number}; it must be at least {least}.")
