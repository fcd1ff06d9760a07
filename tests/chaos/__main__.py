"""``python -m chaos``: the same as ``scripts/chaos``."""

import signal
import sys

from chaos.options import chaos_parser


def _exit(number: int, frame: object) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    if not {"-h", "--help"}.isdisjoint(sys.argv[1:]):  # also where nothing is installed yet
        chaos_parser().print_help()
        sys.exit()
    from orchestrator.ray_session import ray_settings

    signal.signal(signal.SIGTERM, _exit)  # unwinds, so that a run that is under way is ended too
    with ray_settings(None) as scratch:
        # Imported here, because it imports Ray, which reads its settings then.
        from chaos.command import main

        sys.exit(main(None, scratch))
