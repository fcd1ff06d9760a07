"""Makes what the command asks for: ``mlbs-actors make``."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from functools import partial

from mlbs_actors.errors import ConfigError
from orchestrator.make.choice import parse_only
from orchestrator.make.ground import ground_of
from orchestrator.make.kinds import KINDS
from orchestrator.make.making import Request, make
from orchestrator.make.moments import Span, parse_moment
from orchestrator.make.writing import Manner

__all__ = ["make_asked"]


def make_asked(given: argparse.Namespace) -> int:
    """Make it; return the exit status: 0 made, 1 a disk error, 2 impossible."""
    try:
        kinds = list(dict.fromkeys(given.kind.split(",")))
        if unknown := [kind for kind in kinds if kind not in KINDS]:
            raise ConfigError(
                f"There is no kind {unknown[0]!r}; there are {', '.join(KINDS)}. For tables and other "
                "formats see export --help."
            )
        for path in make([_request(given, kind) for kind in kinds], partial(print, file=sys.stderr)):
            print(path)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(
            f"{error.filename or given.out or given.run} cannot be written: {error.strerror}.",
            file=sys.stderr,
        )
        return 1
    return 0


def _request(given: argparse.Namespace, kind: str) -> Request:
    if given.each and kind != "cutout":
        raise ConfigError("--each goes with cutout only; leave it out.")
    if given.apart and kind != "clips":
        raise ConfigError("--apart goes with clips only; leave it out.")
    if given.over is not None and (kind != "cutout" or given.each):
        raise ConfigError("--over goes with cutout only, without --each; leave it out.")
    if given.labels is False and given.ids:
        raise ConfigError("--no-labels draws nothing, and --ids ids; leave one of them out.")
    begin = parse_moment(given.begin) if given.begin else Span().begin
    manner = replace(
        Manner.asked(kind, labels=given.labels, ids=given.ids),
        each=given.each,
        apart=given.apart,
        over=None if given.over is None else ground_of(given.over),
    )
    return Request(
        kind=kind,
        run=given.run,
        manner=manner,
        out=given.out,
        suffix=None if given.format is None else f".{given.format.lstrip('.')}",
        stream=given.stream,
        edits=given.edits,
        choice=parse_only(given.only, given.least_score),
        variant="-".join([*(given.only.split(",") if given.only else ()), *manner.variant(kind)]),
        span=Span(begin, parse_moment(given.end) if given.end else None),
        replace=given.replace,
    )
