"""Entry point of ``python -m orchestrator``."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status (see ``--help``)."""
    # Until the run has its own handlers, a signal unwinds the stack, so that a Ray that is just starting
    # is ended too.
    signal.signal(signal.SIGTERM, _exit)
    signal.signal(signal.SIGINT, _exit)
    # Imported here, because that takes a second, in which a signal may come.
    from orchestrator.command import run_command

    return run_command(sys.argv[1:] if argv is None else argv)


def _exit(number: int, frame: object) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
