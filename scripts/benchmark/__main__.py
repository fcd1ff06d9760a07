"""``python -m benchmark``: the same as ``scripts/bench``."""

import signal
import sys

from benchmark.options import benchmark_parser


def _exit(number: int, frame: object) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    if not {"-h", "--help"}.isdisjoint(sys.argv[1:]):  # also where nothing is installed yet
        benchmark_parser().print_help()
        sys.exit()
    from orchestrator.ray_session import ray_settings

    signal.signal(signal.SIGTERM, _exit)  # unwinds, so that a Ray that is running is ended too
    with ray_settings(None) as scratch:
        # Imported here, because it imports Ray, which reads its settings then.
        from benchmark.command import main

        sys.exit(main(None, scratch))
