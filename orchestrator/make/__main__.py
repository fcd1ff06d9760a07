"""``mlbs-actors make KIND RUN [OUT]``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from orchestrator.make.kinds import KINDS
from orchestrator.program import program_name

__all__ = ["main"]

_PRIVACY = """\
The sound is copied. Whatever is blurred, pixelated or cut out is what the run has found: what it missed is
seen, and people are known by more than their faces. That is no promise of privacy."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 made, 1 a disk error, 2 impossible."""
    given = _parser().parse_intermixed_args(argv)  # OUT may follow options
    from orchestrator.make.command import make_asked  # the help needs nothing that is installed

    return make_asked(given)


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
        "--labels",
        action=argparse.BooleanOptionalAction,
        help="draw the objects, or nothing: in overlay, gif and sheet they are drawn by default, in clips "
        "they are not",
    )
    parser.add_argument(
        "--ids", action=argparse.BooleanOptionalAction, help="draw them there with their ids, or without"
    )
    parser.add_argument(
        "--over",
        metavar="FILE",
        help="cutout: an ordinary video of the objects over this one, which fills the picture and is "
        "repeated if it is shorter",
    )
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
