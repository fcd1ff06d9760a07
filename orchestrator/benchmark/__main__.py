"""``python -m orchestrator.benchmark``: the same as ``scripts/bench``."""

import sys

from orchestrator.benchmark.command import main

if __name__ == "__main__":
    sys.exit(main())
