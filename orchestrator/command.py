"""The command as a whole: arguments are checked, then run; an error becomes a message and an exit status."""

from __future__ import annotations

from collections.abc import Sequence

from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.command_line import parse
from orchestrator.interruption import StopAtOnce
from orchestrator.log import Log
from orchestrator.ray_session import ray_settings, starting_ray
from orchestrator.run.argument_streams import argument_streams
from orchestrator.run.stream_list import missing_sources, read_stream_list

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
        arguments = parse(argv)
        log = Log(arguments.log, str(arguments.output.resolve()))
        if arguments.zones.fault is not None:
            log.warn(arguments.zones.fault)
        streams = () if arguments.streams is None else read_stream_list(arguments.streams)
        streams += argument_streams(arguments.sources, [stream.name for stream in streams])
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
        config = load_config(arguments.config, arguments.set)
        missing = missing_sources(arguments.streams, streams)
        with (
            ray_settings(arguments.address) as scratch,
            starting_ray(arguments.address, scratch, arguments.ray_metrics) as head,
        ):
            # Imported here, because it imports Ray, which reads its settings then.
            from orchestrator.run.run import run

            return run(arguments, streams, missing, config, scratch, head, log)
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
