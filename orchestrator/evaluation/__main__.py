"""``python -m orchestrator.evaluation``: the same as ``scripts/evaluate``."""

import sys

from orchestrator.evaluation.options import evaluation_parser

if __name__ == "__main__":
    if not {"-h", "--help"}.isdisjoint(sys.argv[1:]):  # also where nothing is installed yet
        evaluation_parser().print_help()
        sys.exit()
    from orchestrator.evaluation.command import main

    sys.exit(main())
