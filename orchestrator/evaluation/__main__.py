"""``python -m orchestrator.evaluation``: the same as ``scripts/evaluate``."""

import sys

from orchestrator.evaluation.command import main

if __name__ == "__main__":
    sys.exit(main())
