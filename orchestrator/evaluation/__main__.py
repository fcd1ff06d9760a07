"""``mlbs-actors evaluate`` and ``scripts/evaluate``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from orchestrator.evaluation.options import SCRIPT, evaluation_parser
from orchestrator.program import program_name

__all__ = ["main"]


def main(argv: Sequence[str], program: str | None = None) -> int:
    """Run the command; return its exit status.

    Parameters
    ----------
    argv : sequence of str
    program : str, optional
        What its user has typed, for the help; by default the command of the program.
    """
    program = program or f"{program_name()} evaluate"
    if not {"-h", "--help"}.isdisjoint(argv):  # also where nothing is installed yet
        evaluation_parser(program).print_help()
        return 0
    from orchestrator.evaluation.command import main as evaluate

    return evaluate(argv, program)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], SCRIPT))
