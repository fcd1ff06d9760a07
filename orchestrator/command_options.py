"""The options of the command and its help, for which nothing has to be installed but Python."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.credentials import PASSWORD_VARIABLE
from orchestrator.log import FORMATS
from orchestrator.monitor.address import TOKEN_VARIABLE
from orchestrator.program import program_name, python_name

__all__ = ["LEAST_SIDE", "SAVABLE", "SAVED", "command_parser"]

#: The parts of a record that ``--save`` can name.
SAVABLE = ("masks", "parquet", "overlay", "background", "cutouts")

#: The default of ``--save``.
SAVED = SAVABLE[:3]

#: Least ``--max-side``, px: in smaller pictures there is hardly a trajectory.
LEAST_SIDE = 64

_EXAMPLES = """\
examples:
  {program} street.mp4                     one video; results in street-objects, beside it
  {program} clips/ rtsp://host/stream      each video of a folder, and a camera; results in out
  {program} demo --max-frames 30           the beginning of a built-in scene

"""

_EPILOG = """\
a SOURCE is a video file, a folder or a glob of images, rtsp://HOST/PATH, rtsps://HOST/PATH, http://HOST/PATH
or https://HOST/PATH (MJPEG), /dev/videoN, demo or another made scene, synthetic:demo?frames=60&seed=1
a folder or a glob of videos is a stream for each of them; so is a glob of folders of images, such as
'DAVIS/JPEGImages/480p/*', and of images in many folders, 'moseg_dataset/*/*.ppm'
a stream is named after the last part of its source's path; of several clip.mp4 the second one is clip-2
a camera is read until --max-frames or a signal; one that is away, also at the start, is tried again for ever,
or for --give-up-after SECONDS

the list of streams, one a line (shell quoting, # comments, relative paths count from the list's folder):
  SOURCE
  NAME SOURCE             a name of your own; of a folder or glob of videos NAME-FILE

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
  PYTHON -m orchestrator.export FORMAT DIR OUT   csv, coco, mot, mots, davis, youtube-vos, overlay, rerun
  PYTHON -m orchestrator.disk_use DIR            bytes a frame and GB a day of each stream
  PYTHON -m orchestrator.report DIR              report.html anew, also of a run that was killed

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
    """Return the parser of the command."""
    parser = _Parser(
        prog=program_name(),
        usage="%(prog)s [SOURCE ...] [--streams LIST] [--output DIR] [flags]",
        description="Segment every independently moving object in many moving-camera videos at once: "
        "a label map for every frame of every stream.",
        epilog=_EPILOG.replace("PYTHON", python_name()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("sources", nargs="*", metavar="SOURCE", help="a video or another source, see below")
    parser.add_argument(
        "--streams", type=Path, metavar="LIST", help="a list of streams, which come before those of SOURCE"
    )
    parser.add_argument("--or-demo", action="store_true", help=argparse.SUPPRESS)  # of scripts/run
    parser.add_argument(
        "--output",
        metavar="DIR",
        help="folder for the results; one that holds a run is refused without --resume (default: out; "
        "without a list, NAME-objects beside a single file or folder; and if that is there, out-2 and so on, "
        "with --resume the last one)",
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="YAML file with parameters")
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="parameters, after those of --config; for example layers.lookahead=4",
    )
    parser.add_argument(
        "--address",
        metavar="ADDR",
        help="join the Ray cluster at HOST:PORT, or auto (default: one of this run's own, on this machine)",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="continue the run in DIR that was killed or interrupted, or start one if there is none; all "
        "other options must be the same; cameras continue after a row gap",
    )
    parser.add_argument(
        "--save",
        default=",".join(SAVED),
        metavar="PARTS",
        help=f"which of {', '.join(SAVABLE)} to write, with commas (default: the first three)",
    )
    parser.add_argument(
        "--monitor",
        nargs="?",
        const="",
        metavar="[HOST:]PORT",
        help="serve a live page on this machine, and figures for Prometheus at /metrics there; at another "
        "HOST viewers need the token in the "
        f"environment variable {TOKEN_VARIABLE} (default PORT: any that is free)",
    )
    parser.add_argument(
        "--ray-metrics",
        nargs="?",
        const="",
        metavar="PORT",
        help="export the figures of every stream through Ray to Prometheus, at PORT of this machine; with "
        "--address, without PORT, with those of the cluster; needs pip install 'mlbs-actors[ray-metrics]'",
    )
    parser.add_argument(
        "--max-frames", type=_positive, metavar="N", help="stop each stream after N label maps"
    )
    parser.add_argument(
        "--max-side",
        type=_side,
        metavar="N",
        help="process pictures shrunk to N px on the longer side; all results have full "
        "size, with outlines as coarse as the smaller picture (default: process them as they are)",
    )
    parser.add_argument(
        "--ignore",
        action="append",
        default=[],
        metavar="[NAME=]FILE",
        help="what is fixed in the picture of the stream NAME (default: of all), besides what is found by "
        "itself: a picture in which it is not 0, or a text file with a polygon on each line, x1,y1,x2,y2,… "
        "from 0 to 1 of the picture's width and height; may be given again for other streams",
    )
    parser.add_argument(
        "--zones",
        type=Path,
        metavar="FILE",
        help="YAML file with zones and lines of each stream, and the least size, age and speed of objects, "
        "for the events in DIR/NAME/events.jsonl",
    )
    parser.add_argument(
        "--events",
        action="append",
        default=[],
        metavar="URL",
        help="send events to mqtt://[USER[:PASSWORD]@]HOST[:PORT]/TOPIC (mqtts: by TLS), or as a POST to a "
        "webhook at http:// or https://; for a USER without PASSWORD that of the environment variable "
        f"{PASSWORD_VARIABLE} is taken; may be given again",
    )
    parser.add_argument(
        "--segment",
        metavar="TIME",
        help="write the record of each camera in segments of an hour, a day, or so many seconds: a folder "
        "DIR/NAME/TIME for each, with one archive of all masks (default: none; with --keep hour)",
    )
    parser.add_argument(
        "--keep",
        action="append",
        default=[],
        metavar="LIMIT",
        help="of cameras delete the oldest closed segments, so that what is left is not older than an age, "
        "such as 7d, or all together not larger than a size, such as 50GB; may be given twice, once for each",
    )
    parser.add_argument(
        "--watch",
        action="store_true",
        help="read the list again whenever it changes: new names start, removed ones are finished, bad lines "
        "are reported and ignored until they are corrected; the run continues until a signal; with --resume "
        "the list may also change between two runs",
    )
    parser.add_argument(
        "--give-up-after",
        type=_positive,
        metavar="SECONDS",
        help="end the stream of a camera that sent no picture for this long, also at the start (default: try "
        "it again for ever)",
    )
    parser.add_argument(
        "--places",
        type=_positive,
        metavar="N",
        help="run N streams at once, whatever they take (default: two files a core, and cameras as long as "
        "CPU time and memory last for what they are measured to take)",
    )
    parser.add_argument(
        "--log",
        choices=FORMATS,
        default="text",
        help="how progress and messages are written: json for JSON lines (default: text, a live table on a "
        "terminal, else a line of text per stream when something changes, and now and then)",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    return parser


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


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def _side(text: str) -> int:
    if not text.isdecimal() or int(text) < LEAST_SIDE:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least {LEAST_SIDE}")
    return int(text)


class _Parser(argparse.ArgumentParser):
    """A parser whose help begins with examples."""

    def format_help(self) -> str:
        """Return the help."""
        return _EXAMPLES.format(program=self.prog) + super().format_help()
