"""The command line: options, and how wrong ones are refused."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mlbs_actors import __version__
from mlbs_actors.errors import ConfigError
from orchestrator.credentials import mask
from orchestrator.events.targets import PASSWORD_VARIABLE, EventTarget, parse_target
from orchestrator.events.zones import ZonesFile, read_zones
from orchestrator.ignored import Ignored, read_ignored
from orchestrator.log import FORMATS, LogFormat
from orchestrator.mistaken_flags import refuse_source_behind, unknown_flag
from orchestrator.monitor.address import TOKEN_VARIABLE, MonitorAddress
from orchestrator.program import command_line_of, program_name, python_name
from orchestrator.run.argument_streams import DEMO, argument_address, default_output
from orchestrator.run.retention_limits import HOUR, Keep, parse_keep, parse_segment

__all__ = ["SAVABLE", "SAVED", "Arguments", "parse"]

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

while it runs: a table on a terminal, else JSON lines on standard output; messages on standard error
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


@dataclass(frozen=True, slots=True)
class Arguments:
    """The options of the command.

    Attributes
    ----------
    sources : tuple of str
        Sources named as arguments.
    streams : Path, optional
        The list of streams, which come before them.
    output : Path
        Folder of the record.
    config : Path, optional
        YAML file of parameters.
    overrides : tuple of str
        ``section.key=value`` each, applied after the file.
    address : str, optional
        Ray cluster to join; None for one of this run's own.
    resume : bool
        Continue the run in ``output``.
    save : frozenset of str
        Parts of :data:`SAVABLE`.
    monitor : MonitorAddress, optional
        Where to serve the live page.
    ray_metrics : int, optional
        Port of this machine where Ray exports the figures of the streams to Prometheus; 0 for the port of the
        cluster at ``address``.
    max_frames : int, optional
        Label maps to make of each stream.
    max_side : int, optional
        Longest side of the pictures that are processed, px.
    ignored : Ignored
        What is fixed in the pictures.
    zones : ZonesFile
        What the events of each stream depend on.
    events : tuple of EventTarget
        Where to send them.
    watch : bool
        Whether the list is read again when it changes.
    segment : int, optional
        Length of the segments of cameras, s; None for no segments.
    keep : Keep, optional
        How much of the record of cameras is kept; None for all.
    give_up_after : int, optional
        Time without a picture after which a camera is given up, s.
    places : int, optional
        Streams at once, whatever they take.
    log : LogFormat
        How progress and messages are written where no table is shown.
    """

    sources: tuple[str, ...]
    streams: Path | None
    output: Path
    config: Path | None
    overrides: tuple[str, ...]
    address: str | None
    resume: bool
    save: frozenset[str]
    monitor: MonitorAddress | None
    ray_metrics: int | None
    max_frames: int | None
    max_side: int | None
    ignored: Ignored
    zones: ZonesFile
    events: tuple[EventTarget, ...]
    watch: bool
    segment: int | None
    keep: Keep | None
    give_up_after: int | None
    places: int | None
    log: LogFormat

    def command(self, output: str) -> list[str]:
        """Return the arguments that start the same run from any folder, with another output folder."""
        words = [
            sys.executable,
            "-m",
            "orchestrator",
            *(argument_address(source).location for source in self.sources),
        ]
        if self.streams is not None:
            words += ["--streams", str(self.streams.absolute())]
        words += ["--output", output]
        if self.config is not None:
            words += ["--config", str(self.config.absolute())]
        if self.overrides:
            words += ["--set", *self.overrides]
        if self.address is not None:
            words += ["--address", self.address]
        words += ["--save", ",".join(part for part in SAVABLE if part in self.save)]
        if self.max_frames is not None:
            words += ["--max-frames", str(self.max_frames)]
        if self.max_side is not None:
            words += ["--max-side", str(self.max_side)]
        for word in self.ignored.digests:
            words += ["--ignore", word]
        if self.zones.path is not None:
            words += ["--zones", str(self.zones.path)]
        for target in self.events:
            words += ["--events", target.shown]
        if self.segment is not None:
            words += ["--segment", str(self.segment)]
        if self.keep is not None:
            words += [word for limit in self.keep.words for word in ("--keep", limit)]
        if self.watch:
            words.append("--watch")
        if self.give_up_after is not None:
            words += ["--give-up-after", str(self.give_up_after)]
        if self.places is not None:
            words += ["--places", str(self.places)]
        return words


def parse(argv: Sequence[str]) -> Arguments:
    """Read the command line.

    Raises
    ------
    ConfigError
        If an option or value is not supported.
    SystemExit
        From argparse: 0 after ``--help``, 2 if the arguments do not fit the usage.
    """
    parser = _parser()
    # Intermixed: sources may stand before and after flags.
    given, unknown = parser.parse_known_intermixed_args(argv)
    if unknown:
        known = [f"--{name.replace('_', '-')}" for name in vars(given) if name not in ("sources", "or_demo")]
        parser.error(unknown_flag(unknown[0], known))
    for flag, words in (
        ("--set", given.set),
        ("--monitor", [given.monitor]),
        ("--ray-metrics", [given.ray_metrics]),
    ):
        refuse_source_behind(flag, words)
    if given.watch and given.streams is None:
        raise ConfigError(
            "--watch reads a list again; write your sources into one and name it with --streams."
        )
    keep = parse_keep(given.keep) if given.keep else None
    sources = tuple(given.sources)
    if not sources and given.streams is None:
        if not given.or_demo:
            raise ConfigError(
                f"Name a video, a folder of videos or images, or a camera: {command_line_of('street.mp4')}; "
                f"or try {command_line_of('demo')}. All else: {command_line_of('--help')}"
            )
        sources = (DEMO,)
    if given.output is not None:
        output = _folder(given.output)
    else:
        output = Path("out") if given.streams else default_output(sources, resume=given.resume)
    return Arguments(
        sources=sources,
        streams=given.streams,
        output=output,
        config=given.config,
        overrides=tuple(given.set),
        address=None if given.address is None else _cluster_address(given.address),
        resume=given.resume,
        save=_parts(given.save),
        monitor=None if given.monitor is None else _monitor_address(given.monitor),
        ray_metrics=None if given.ray_metrics is None else _metrics_port(given.ray_metrics, given.address),
        max_frames=given.max_frames,
        max_side=given.max_side,
        ignored=read_ignored(given.ignore),
        zones=ZonesFile() if given.zones is None else read_zones(given.zones),
        events=tuple(parse_target(text) for text in given.events),
        watch=given.watch,
        segment=parse_segment(given.segment) if given.segment else HOUR if keep else None,
        keep=keep,
        give_up_after=given.give_up_after,
        places=given.places,
        log=given.log,
    )


def _folder(text: str) -> Path:
    if text[1:3] in (":\\", ":/"):
        raise ConfigError(
            f"--output takes a folder of this machine, not {text!r}; where WSL has the drives of Windows: "
            f"--output {shlex.quote(f'/mnt/{text[0].lower()}/' + text[3:].replace(chr(92), '/'))}"
        )
    if "://" in text:
        raise ConfigError(
            f"--output takes a folder of this machine, not {mask(text)!r}; mount the storage and name the "
            "folder, or copy the results there afterwards."
        )
    return Path(text)


def _cluster_address(text: str) -> str:
    if text.startswith("ray://"):
        raise ConfigError(
            "--address cannot be a ray:// proxy; run on a machine of the cluster and give HOST:PORT or auto."
        )
    host, _, port = text.rpartition(":")
    if text != "auto" and not (host and port.isascii() and port.isdecimal() and 0 < int(port) < 2**16):
        raise ConfigError(
            f"--address takes HOST:PORT, such as 10.0.0.5:6379, or auto for the cluster of this machine; "
            f"not {mask(text)!r}."
        )
    return text


def _parts(text: str) -> frozenset[str]:
    parts = [part.strip() for part in text.split(",")]
    for part in parts:
        if part not in SAVABLE:
            asked = f"knows no {part!r}" if part else "names nothing"
            raise ConfigError(f"--save {asked}; choose from {', '.join(SAVABLE)}.")
    return frozenset(parts)


def _monitor_address(text: str) -> MonitorAddress:
    """Read ``[HOST:]PORT``; empty for any free port of this machine."""
    host, _, port = text.rpartition(":")
    if text and not (port.isascii() and port.isdecimal() and int(port) < 2**16):
        raise ConfigError(f"--monitor takes PORT or HOST:PORT, not {text!r}.")
    return MonitorAddress(host or "127.0.0.1", int(port or 0))


def _metrics_port(text: str, address: str | None) -> int:
    if address is not None:
        if text:
            raise ConfigError(
                "With --address metrics come from ports of the cluster; give --ray-metrics without PORT."
            )
        return 0
    if not (text.isascii() and text.isdecimal() and 0 < int(text) < 2**16):
        raise ConfigError(
            "--ray-metrics takes a PORT of this machine, from 1 to 65535, such as --ray-metrics 9465."
        )
    return int(text)


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


def _parser() -> argparse.ArgumentParser:
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
    parser.add_argument("--version", action="version", version=f"mlbs-actors {__version__}")
    return parser
