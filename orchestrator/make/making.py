"""Makes things of the streams of a run, and puts them where they belong."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import av.error

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.edits import EDITS
from mlbs_actors.record.recorded_stream import description_of, edits_of, streams_of
from mlbs_actors.wording import count_of
from orchestrator.export.made_folder import is_made, mark_made
from orchestrator.make.choice import EVERYTHING, Choice
from orchestrator.make.footage import Footage
from orchestrator.make.moments import ALL, Span
from orchestrator.make.watching import Watch
from orchestrator.make.writing import Manner, files_of, suffixes_of, write
from orchestrator.pictures.privacy import is_private
from orchestrator.sinks.record import recorded_frames
from orchestrator.sources.address import parse_address
from orchestrator.sources.libav import reason

__all__ = ["MADE", "Place", "Request", "make"]

#: Folder of what is made, in that of the stream.
MADE = "made"


@dataclass(frozen=True, slots=True)
class Place:
    """Where something is put.

    Attributes
    ----------
    folder : Path
    stem, suffix : str
        Name of the file, and its ending.
    """

    folder: Path
    stem: str
    suffix: str


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be made.

    Attributes
    ----------
    kind : str
    run : Path
    out : Path, optional
        A file, if it has an ending, else a folder to put it into; by default the folder ``made`` of each
        stream. Of what is made as a folder (see :func:`~.writing.files_of`) the name without its ending.
    suffix : str, optional
        Ending of the file, if ``out`` has none.
    stream : str, optional
        The only stream.
    edits : Path, optional
        Corrections of ids in place of those in the stream's folder.
    choice : Choice
    variant : str
        What is special about it, for the name of its file: which objects, or that ids are not drawn.
    span : Span
    manner : Manner
    replace : bool
        Whether files that are there already are replaced, and folders that this has made.
    """

    kind: str
    run: Path
    manner: Manner
    out: Path | None = None
    suffix: str | None = None
    stream: str | None = None
    edits: Path | None = None
    choice: Choice = EVERYTHING
    variant: str = ""
    span: Span = ALL
    replace: bool = False


@dataclass(frozen=True, slots=True)
class _Task:
    """A request that can be tried.

    Attributes
    ----------
    request : Request
    sources : mapping of str to str
        Streams → their sources.
    places : mapping of str to Place
        Streams → where to put what is made of them; what is there may be replaced.
    """

    request: Request
    sources: Mapping[str, str]
    places: Mapping[str, Place]

    @classmethod
    def of(cls, request: Request) -> _Task:
        sources = _sources(request)
        places = {name: _place(request, name, alone=len(sources) == 1) for name in sources}
        for place in places.values():
            _refuse_if_there(request, place)
        return cls(request, sources, places)


def make(requests: Sequence[Request], say: Callable[[str], None]) -> Iterator[Path]:
    """Make what is asked for of every stream, or of one; nothing unless each request can be tried.

    Parameters
    ----------
    requests : sequence of Request
        Of one run.
    say : callable
        Is told what is missing, and why; and how far it is, if standard error is no terminal.

    Yields
    ------
    Path
        What was made: a file or a folder.

    Raises
    ------
    ConfigError
        If it is there already, or two requests have one place; or at last, if one could not be made of any
        stream.
    OSError
        If it cannot be written.
    """
    tasks = [_Task.of(request) for request in requests]
    _refuse_one_place_for_two(tasks)
    faults: list[str] = []
    for task in tasks:
        try:
            yield from _made_of_streams(task, say)
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError(" ".join(dict.fromkeys(faults)))


def _made_of_streams(task: _Task, say: Callable[[str], None]) -> Iterator[Path]:
    request, private = task.request, is_private(description_of(task.request.run))
    made, faults = 0, []
    for name, source in task.sources.items():
        folder = request.run / name
        try:
            edits = edits_of(folder, request.edits)
            footage = Footage.of(folder, source, request.choice, request.span, edits, private=private)
            footage.watch = Watch(say)
            path, remarks = _made(request, footage, task.places[name])
        except ConfigError as error:
            faults.append(str(error))
            continue
        if edits.edits:
            corrections = count_of(len(edits.edits), "correction")
            say(f"{path.name}: with {corrections} of {request.edits or folder / EDITS}.")
        for remark in remarks:
            say(remark)
        made += 1
        yield path
    if not made:
        raise ConfigError(" ".join(faults))
    for fault in faults:
        say(fault)


def _sources(request: Request) -> Mapping[str, str]:
    """Return the streams of which something is to be made, and their sources."""
    sources = streams_of(request.run)
    if request.stream is not None:
        if request.stream not in sources:
            raise ConfigError(
                f"There is no stream {request.stream!r} in this run; there are {', '.join(sources)}."
            )
        return {request.stream: sources[request.stream]}
    recorded = {name: source for name, source in sources.items() if recorded_frames(request.run / name)}
    if not recorded:
        raise ConfigError(f"The run in {request.run} has no label maps.")
    # Of a run with a camera and files, these.
    files = {name: source for name, source in recorded.items() if not _is_camera(source)} or recorded
    for given, flag in ((request.choice.ids, "--only with ids"), (request.edits, "--edits")):
        if given and len(files) > 1:
            raise ConfigError(f"{flag} is about one stream; say with --stream which: {', '.join(files)}.")
    return files


def _is_camera(source: str) -> bool:
    return parse_address(source, Path("/")).live


def _place(request: Request, name: str, *, alone: bool) -> Place:
    suffixes = suffixes_of(request.kind, request.manner)
    out, suffix = request.out, request.suffix or suffixes[0]
    stem = f"{request.kind}-{request.variant}" if request.variant else request.kind
    if suffix not in suffixes:
        raise ConfigError(f"{request.kind} is written as {' or '.join(suffixes)}, not as {suffix}.")
    if out is None:
        return Place(request.run / name / MADE, stem, suffix)
    if not out.suffix or out.is_dir():
        return Place(out, f"{name}-{stem}", suffix)
    if not alone:
        raise ConfigError(
            f"{out} is one file, but the run has several streams; name a folder, or one with --stream."
        )
    if out.suffix not in suffixes:
        raise ConfigError(f"{request.kind} is written as {' or '.join(suffixes)}, not as {out.suffix}.")
    return Place(out.parent, out.stem, out.suffix)


def _targets(request: Request, place: Place) -> list[Path]:
    names = files_of(request.kind, place.stem, place.suffix, request.manner)
    return [place.folder / name for name in names]


def _refuse_one_place_for_two(tasks: Sequence[_Task]) -> None:
    taken: dict[Path, str] = {}
    for task in tasks:
        kind = task.request.kind
        for target in chain.from_iterable(_targets(task.request, one) for one in task.places.values()):
            if target in taken:
                raise ConfigError(
                    f"{taken[target]} and {kind} cannot both be written to {target}; name a folder, or make "
                    "one of them at a time."
                )
            taken[target] = kind


def _refuse_if_there(request: Request, place: Place) -> None:
    """Raise ConfigError if anything is in the way that is not, or must not be, replaced."""
    for target in _targets(request, place):
        if not target.exists():
            continue
        if target.name != place.stem:
            if target.is_dir():
                raise ConfigError(f"{target} is a folder; name another place to write to.")
        elif not _is_made(request, target):
            raise ConfigError(
                f"{request.kind} is written to the folder {target} here, but what is there was not made by "
                "this command, and stays; name another place to write to."
            )
        if not request.replace:
            raise ConfigError(f"{target} is there already; name another place to write to, or add --replace.")


def _is_made(request: Request, folder: Path) -> bool:
    """Whether this command has made a folder; of those in :data:`MADE` it has made all."""
    ours = request.out is None and folder.is_dir() and not folder.is_symlink()
    return ours or is_made(folder, request.run)


def _made(request: Request, footage: Footage, place: Place) -> tuple[Path, list[str]]:
    """Make one thing; what is at its place is complete or missing."""
    place.folder.mkdir(parents=True, exist_ok=True)
    targets = _targets(request, place)
    with tempfile.TemporaryDirectory(dir=place.folder, prefix=f".{place.stem}.", suffix=".part") as draft:
        try:
            remarks = write(request.kind, footage, Path(draft), place.stem, place.suffix, request.manner)
        except av.error.FFmpegError as error:
            raise ConfigError(f"{targets[0]} cannot be encoded: {reason(error)}.") from None
        _refuse_if_there(request, place)  # by now, as it may have taken hours
        for target in targets:
            made = Path(draft) / target.name
            if made.is_dir():
                if request.out is not None:
                    mark_made(made)
                if target.exists():
                    shutil.rmtree(target)
            made.replace(target)
    return targets[0], remarks
