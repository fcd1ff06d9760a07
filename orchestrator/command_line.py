"""The command line: what may be asked for, and how it is refused."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mlbs_actors.errors import ConfigError

__all__ = ["SAVABLE", "Arguments", "parse"]

#: The parts of a record that ``--save`` can name.
SAVABLE = ("masks", "parquet", "overlay")

#: Parts that belong to the contract but cannot be made yet.
_LATER = ("background",)

_EPILOG = """\
the list of streams, one a line (shell quoting, # comments, relative paths count from the list's folder):
  URI                     the stream is named after the last part of its path
  NAME URI
a URI is a video file, a folder or a glob of images, rtsp://HOST/PATH, rtsps://HOST/PATH, /dev/videoN
or a made scene, synthetic:demo?frames=60&seed=1

output:
  DIR/run.json                   what was asked for, with versions and hashes
  DIR/status.json                how each stream stands, while running too
  DIR/report.html                how each stream ended
  DIR/ray.log                    warnings of Ray itself
  DIR/NAME/masks/FRAME.png       a pixel's value is its layer's id, 0 is the background
  DIR/NAME/layers-*.parquet      a row per frame and layer
  DIR/NAME/frames-*.parquet      a row per frame
  DIR/NAME/overlay.mp4           the labels over the video
  DIR/NAME/commits.jsonl         what is safely written: nothing counts before its line here

exit status:
  0    every stream was segmented to its end
  1    a stream failed, or is partial (damaged or cut off; what could be read is kept)
  2    the command, the configuration or the list cannot be used; nothing was started
  130, 143  interrupted by SIGINT or SIGTERM; what was read is kept. A second signal ends it at once.
            Both, and a killed run, go on with --resume.
"""


@dataclass(frozen=True, slots=True)
class Arguments:
    """What the user asked for.

    Attributes
    ----------
    streams : Path
        The list of streams.
    output : Path
        Folder of the record.
    config : Path, optional
        YAML file of parameters.
    overrides : tuple of str
        ``section.key=value`` each, applied after the file.
    address : str, optional
        Ray cluster to join; None for one of this run's own.
    resume : bool
        Go on with the run in ``output``.
    save : frozenset of str
        Parts of :data:`SAVABLE`.
    max_frames : int, optional
        Frames to read of each stream.
    """

    streams: Path
    output: Path
    config: Path | None
    overrides: tuple[str, ...]
    address: str | None
    resume: bool
    save: frozenset[str]
    max_frames: int | None


def parse(argv: Sequence[str]) -> Arguments:
    """Read the command line.

    Raises
    ------
    ConfigError
        If something is asked for that does not exist, or not yet.
    SystemExit
        From argparse: 0 after ``--help``, 2 if the arguments do not fit the usage.
    """
    given = _parser().parse_args(argv)
    if given.monitor is not None:
        raise ConfigError("--monitor is not available yet; read status.json in the output folder instead.")
    if given.address is not None and given.address.startswith("ray://"):
        raise ConfigError(
            "--address cannot be a ray:// proxy; run on a machine of the cluster and give HOST:PORT or auto."
        )
    return Arguments(
        streams=given.streams,
        output=given.output,
        config=given.config,
        overrides=tuple(given.overrides),
        address=given.address,
        resume=given.resume,
        save=_parts(given.save),
        max_frames=given.max_frames,
    )


def _parts(text: str) -> frozenset[str]:
    parts = [part.strip() for part in text.split(",")]
    for part in parts:
        if part in _LATER:
            raise ConfigError(f"--save {part} is not available yet; choose from {', '.join(SAVABLE)}.")
        if part not in SAVABLE:
            raise ConfigError(f"--save knows no {part!r}; choose from {', '.join(SAVABLE)}.")
    return frozenset(parts)


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m orchestrator",
        description="Segment every independently moving object in many moving-camera videos at once: "
        "a label map for every frame of every stream.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--streams", type=Path, required=True, metavar="LIST", help="the list of streams")
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("out"),
        metavar="DIR",
        help="folder for the results; one that holds a run is refused without --resume (default: out)",
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="YAML file with parameters")
    parser.add_argument(
        "--set",
        dest="overrides",
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
        help="go on with the run in DIR that was killed or interrupted; all else must be as it was",
    )
    parser.add_argument(
        "--save",
        default="masks,parquet,overlay",
        metavar="PARTS",
        help="which of masks, parquet, overlay to write, with commas (default: all three)",
    )
    parser.add_argument(
        "--monitor", nargs="?", const=0, type=int, metavar="PORT", help="serve a live page (not yet)"
    )
    parser.add_argument(
        "--max-frames", type=_positive, metavar="N", help="stop each stream after its first N frames"
    )
    return parser
