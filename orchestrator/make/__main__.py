"""``mlbs-actors make KIND RUN [OUT]``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from mlbs_actors.errors import ConfigError
from orchestrator.make.choice import parse_only
from orchestrator.make.kinds import KINDS, Manner
from orchestrator.make.making import Request, make
from orchestrator.make.moments import Span, parse_moment
from orchestrator.program import program_name

__all__ = ["main"]

_PRIVACY = """\
The sound is copied. Whatever is blurred, pixelated or cut out is what the run has found: what it missed in a
frame is seen there, and people are known by more than their faces. That is no promise of privacy."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 made, 1 a disk error, 2 impossible."""
    given = _parser().parse_args(argv)
    try:
        kinds = list(dict.fromkeys(given.kind.split(",")))
        if unknown := [kind for kind in kinds if kind not in KINDS]:
            raise ConfigError(f"There is no kind {unknown[0]!r}; there are {', '.join(KINDS)}.")
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
    begin = parse_moment(given.begin) if given.begin else Span().begin
    drawing = None if given.no_labels else Manner.usual(ids=not given.no_ids).drawing
    return Request(
        kind=kind,
        run=given.run,
        manner=Manner(drawing, each=given.each, apart=given.apart),
        out=given.out,
        suffix=None if given.format is None else f".{given.format.lstrip('.')}",
        stream=given.stream,
        edits=given.edits,
        choice=parse_only(given.only, given.least_score),
        only=(given.only or "").replace(",", "-"),
        span=Span(begin, parse_moment(given.end) if given.end else None),
        replace=given.replace,
    )


def _parser() -> argparse.ArgumentParser:
    kinds = "\n".join(f"  {name:<10} {kind.words}" for name, kind in KINDS.items())
    parser = argparse.ArgumentParser(
        prog=f"{program_name()} make",
        description="Make something of what a run has found in files: their pictures are read again.",
        epilog=f"kinds:\n{kinds}\n\n{_PRIVACY}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("kind", metavar="KIND[,KIND]", help="what to make, see below")
    parser.add_argument("run", type=Path, metavar="RUN", help="the run's output folder")
    parser.add_argument(
        "out",
        type=Path,
        nargs="?",
        metavar="OUT",
        help="a file, or without an ending a folder (default: RUN/STREAM/made/KIND)",
    )
    parser.add_argument(
        "--only",
        metavar="WHICH",
        help="ids with commas; largest, the object with the largest area in all these frames together; or "
        "moving, objects in those frames in which they move against the scene (default: all)",
    )
    parser.add_argument(
        "--least-score",
        type=float,
        default=0.0,
        metavar="SCORE",
        help="only objects with at least this score in objects.csv; below 0.3 most are no real ones",
    )
    parser.add_argument(
        "--from", dest="begin", metavar="WHEN", help="first moment: seconds, h:mm:ss, or a frame such as 300f"
    )
    parser.add_argument("--to", dest="end", metavar="WHEN", help="the moment before which it ends")
    parser.add_argument(
        "--no-labels", action="store_true", help="show nothing of objects in clips, gif, sheet and overlay"
    )
    parser.add_argument("--no-ids", action="store_true", help="show objects there without their ids")
    parser.add_argument(
        "--each", action="store_true", help="cutout: a video or a folder of pictures an object"
    )
    parser.add_argument("--apart", action="store_true", help="clips: a video a part, instead of all joined")
    parser.add_argument(
        "--format", metavar="ENDING", help="mp4 or mkv; of cutout mov, webm or png; of sheet jpg or png"
    )
    parser.add_argument("--stream", metavar="NAME", help="only this stream of the run (default: all files)")
    parser.add_argument(
        "--edits",
        type=Path,
        metavar="FILE",
        help="corrections of ids (default: edits.csv in the stream's folder)",
    )
    parser.add_argument("--replace", action="store_true", help="replace what was made before")
    return parser


if __name__ == "__main__":
    sys.exit(main())
