"""The command as a whole: arguments are checked, then run; an error becomes a message and an exit status."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mlbs_actors.config import Config, load_config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.command_line import parse
from orchestrator.interruption import StopAtOnce
from orchestrator.log import Log
from orchestrator.options import Arguments
from orchestrator.ray_session import ray_settings, starting_ray
from orchestrator.run.argument_streams import argument_streams
from orchestrator.run.file_watch import stamp_of
from orchestrator.run.listed_stream import StreamsFile
from orchestrator.run.publication import Publication
from orchestrator.run.resumption import earlier_streams, is_known
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_list import (
    missing_sources,
    parse_stream_list,
    read_stream_list,
    refuse_if_all,
)

__all__ = ["run_command"]


def run_command(argv: Sequence[str]) -> int:
    """Run the streams of a list and of the arguments.

    Parameters
    ----------
    argv : sequence of str
        Without the program's name.

    Returns
    -------
    int
        Exit status; see ``--help``.
    """
    log = Log()
    try:
        with Publication() as publication:
            arguments = parse(argv, publication.begin)
            log = Log(arguments.log, arguments.results)
            return _run(arguments, publication, log)
    except ConfigError as error:
        log.say(str(error), "error")
        return 2
    except MlbsError as error:
        log.say(str(error), "error")
        return 1
    except StopAtOnce as stop:
        log.warn(
            "Stopped at once; what was committed before is kept. "
            "To continue, give the same command with --resume."
        )
        return 128 + stop.signal_number


def _run(arguments: Arguments, publication: Publication, log: Log) -> int:
    """Check what is asked for, and run it; return the exit status."""
    if arguments.zones.fault is not None:
        log.warn(arguments.zones.fault)
    before = _begun(arguments)
    listed = _listed(arguments, before, log)
    names = [stream.name for stream in listed.streams]
    streams = (*listed.streams, *argument_streams(arguments.sources, names))
    listed = replace(listed, streams=streams)
    for fault in arguments.ignore.faults:
        if before is None:
            raise ConfigError(fault)
        log.say(f"{fault} Until it can be read at a start, nothing is ignored there.", "error")
    unknown = sorted(arguments.ignore.streams - {stream.name for stream in streams})
    if unknown and not arguments.watch:
        raise ConfigError(f"--ignore names the stream {unknown[0]!r}, which is not one of this run.")
    unknown = sorted(arguments.zones.streams - {stream.name for stream in streams})
    if unknown and not arguments.watch:
        raise ConfigError(f"--zones names the stream {unknown[0]!r}, which is not one of this run.")
    if unknown:
        log.warn(f"--zones names {', '.join(unknown)}, not streams of this run at present.")
    cameras = [stream for stream in streams if stream.source.live]
    if arguments.segment is not None and not arguments.watch and not cameras:
        raise ConfigError(
            "--segment and --keep are for cameras, of which this run has none; leave them out. "
            "The record of a file is always kept whole."
        )
    config = _parameters(arguments, before, log)
    missing = missing_sources(streams)
    if before is None:
        refuse_if_all(arguments.streams, streams, missing)
    with (
        ray_settings(arguments.address) as scratch,
        starting_ray(arguments.address, scratch, arguments.ray_metrics) as head,
    ):
        # Imported here, because it imports Ray, which reads its settings then.
        from orchestrator.run.run import run

        return run(arguments, listed, missing, config, scratch, head, log, publication)


def _begun(arguments: Arguments) -> RunFolder | None:
    """Return the run that a service goes on with: whatever somebody has edited, it must start."""
    folder = RunFolder(arguments.output.resolve())
    return folder if arguments.resume and arguments.watch and folder.holds_run else None


def _listed(arguments: Arguments, before: RunFolder | None, log: Log) -> StreamsFile:
    """Read the list; of a run that goes on with what was in force where it cannot be used."""
    if arguments.streams is None:
        return StreamsFile((), {})
    stamp = stamp_of(arguments.streams)
    if before is None:
        return replace(read_stream_list(arguments.streams), stamp=stamp)
    earlier = earlier_streams(before, arguments.streams)
    try:
        parsed = parse_stream_list(arguments.streams, earlier)
    except ConfigError as error:
        log.say(f"{error} What was in force before goes on.", "error")
        parsed = earlier
    for number, fault in sorted(parsed.faults.items()):
        log.say(f"{arguments.streams}, line {number}: {fault}. It is ignored until it is mended.", "error")
    hidden = [stream.name for stream in parsed.streams if not is_known(stream.source)]
    if hidden:
        log.say(f"Without the list the addresses of {', '.join(hidden)} are not known; they wait.", "error")
    usable = tuple(one for one in parsed.streams if one.name not in hidden)
    return replace(parsed, streams=usable, stamp=stamp)


def _parameters(arguments: Arguments, before: RunFolder | None, log: Log) -> Config:
    try:
        return load_config(arguments.config, arguments.set)
    except ConfigError as error:
        if before is None:
            raise
        log.say(f"{error} The parameters of before hold on.", "error")
        return Config.model_validate(before.description()["config"])
