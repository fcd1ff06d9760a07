"""Entry point of ``python -m orchestrator``."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence

from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.command_line import parse
from orchestrator.credentials import mask
from orchestrator.interruption import StopAtOnce
from orchestrator.ray_session import ray_settings
from orchestrator.stream_list import missing_sources, read_stream_list

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status (see ``--help``)."""
    # Until the run has its own handlers, a signal unwinds the stack, so that a Ray that is just starting
    # is ended too.
    signal.signal(signal.SIGTERM, _exit)
    signal.signal(signal.SIGINT, _exit)
    try:
        arguments = parse(sys.argv[1:] if argv is None else argv)
        streams = read_stream_list(arguments.streams)
        config = load_config(arguments.config, arguments.overrides)
        missing = missing_sources(arguments.streams, streams)
        with ray_settings(arguments.address) as scratch:
            # Imported here, because it imports Ray, which reads its settings then.
            from orchestrator.run import run

            return run(arguments, streams, missing, config, scratch)
    except ConfigError as error:
        print(mask(str(error)), file=sys.stderr)
        return 2
    except MlbsError as error:
        print(mask(str(error)), file=sys.stderr)
        return 1
    except StopAtOnce as stop:
        print("Stopped at once; what was committed before is kept.", file=sys.stderr)
        return 128 + stop.signal_number


def _exit(number: int, frame: object) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
