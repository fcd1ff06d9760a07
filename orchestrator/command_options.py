"""The parser of a run and its help, made of :mod:`orchestrator.options`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from orchestrator.option import Form
from orchestrator.options import options
from orchestrator.program import EXAMPLES, program_name

__all__ = ["command_parser", "flag_of"]

_EPILOG = """\
a SOURCE is a video file, a folder or a glob of images; a camera: rtsp(s)://HOST/PATH, http(s)://HOST/PATH
(MJPEG, a JPEG, HLS, live video), rtmp(s)://HOST/PATH, udp://@:PORT or tcp://HOST:PORT (MPEG-TS), /dev/videoN;
demo or another made scene, synthetic:demo?frames=60&seed=1
a folder or a glob of videos is a stream for each of them; so is a glob of folders of images, such as
'DAVIS/JPEGImages/480p/*', and of images in many folders, 'moseg_dataset/*/*.ppm'
a stream is named after the last part of its source's path; of several clip.mp4 the second one is clip-2
a camera is read until --max-frames or a signal; one that is away, also at the start, is tried again for ever,
or for --give-up-after SECONDS

the list of streams, one a line (shell quoting, # comments, relative paths count from the list's folder):
  SOURCE
  NAME SOURCE             a name of your own; of a folder or glob of videos NAME-FILE
or a file of cameras, LIST.yaml, in which each stream has zones, limits and parameters of its own

output:
  DIR/run.json                   what was asked for, with versions and hashes
  DIR/status.json                how each stream stands, while running too
  DIR/report.html                pictures, objects over time, faults; one page, no server needed
  DIR/ray.log                    warnings of Ray itself
  DIR/NAME/masks/FRAME.png       a pixel's value is its layer's id, 0 is the background; an
                                 indexed picture: read it with Pillow, cv2.imread gives colours
  DIR/NAME/objects.csv, .json    a row per object: when, where, how it ended, a score of its masks
  DIR/NAME/layers-*.parquet      a row per frame and layer
  DIR/NAME/frames-*.parquet      a row per frame
  DIR/NAME/events.jsonl          what happened: births and ends of objects, zones, the camera
  DIR/NAME/overlay.mp4           the labels over the video
  DIR/NAME/background/FRAME.png  the background without objects, now and then; with --save background
  DIR/NAME/cutouts/FRAME-ID.png  each object by itself; with --save cutouts
  DIR/NAME/TIME/                 the same of an hour of a camera, with masks.tar; with --segment or --keep
  DIR/NAME/commits.jsonl         what is safely written: nothing counts before its line here

while it runs: a table on a terminal, else lines of text on standard output (--log json: JSON lines);
messages on standard error
afterwards:
  PROGRAM export FORMAT DIR OUT   csv, coco, mot, mots, davis, youtube-vos, overlay, rerun
  PROGRAM disk-use DIR            bytes a frame and GB a day of each stream
  PROGRAM fetch s3://... DIR        DIR as it was published, with an object store as --output
  PROGRAM report DIR              report.html anew, also of a run that was killed
  PROGRAM --help                  all commands

exit status:
  0    every stream was segmented to its end; that of a camera without --max-frames is SIGINT or SIGTERM
  1    a stream failed, or is partial (damaged or cut off; what could be read is kept)
  2    the command, the configuration or the list cannot be used, or no stream has a source;
       nothing was started
  130, 143  interrupted by SIGINT or SIGTERM before the end of another stream; what was read is kept
  141  the same, because nobody reads the output any more, as after | head -1
a second signal ends the run at once, with 130 or 143; it goes on with --resume, as does a killed one
"""


def command_parser() -> argparse.ArgumentParser:
    """Return the parser of the command; it leaves every value as it was given, or None."""
    parser = _Parser(
        prog=program_name(),
        usage="%(prog)s [SOURCE ...] [--streams LIST] [--output DIR] [flags]",
        description="Segment every independently moving object in many moving-camera videos at once: "
        "a label map for every frame of every stream.",
        epilog=_EPILOG.replace("PROGRAM", program_name()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("sources", nargs="*", metavar="SOURCE", help="a video or another source, see below")
    parser.add_argument("--or-demo", action="store_true", help=argparse.SUPPRESS)  # of scripts/run
    for name, option in options():
        more: dict[str, Any] = {"metavar": option.metavar}
        match option.form:
            case Form.FLAG:
                more = {"action": "store_true"}
            case Form.REPEATED:
                more |= {"action": "append", "default": []}
            case Form.WORDS:
                more |= {"action": "extend", "nargs": "+", "default": []}
            case Form.OPTIONAL_VALUE:
                more |= {"nargs": "?", "const": ""}
        parser.add_argument(flag_of(name), help=option.meaning.replace("%", "%%"), **more)
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    return parser


def flag_of(name: str) -> str:
    """Return the flag of an option."""
    return f"--{name.replace('_', '-')}"


class _Version(argparse.Action):
    """Shows the version of the package, which is imported only then."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        """Print and exit."""
        from mlbs_actors import __version__

        print(f"mlbs-actors {__version__}")
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """A parser whose help begins with examples."""

    def format_help(self) -> str:
        """Return the help."""
        return EXAMPLES.format(program=self.prog) + super().format_help()
