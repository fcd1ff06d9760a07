"""The command line: what is asked for, and how wrong options are refused."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mlbs_actors.errors import ConfigError
from orchestrator.command_options import SAVABLE, command_parser
from orchestrator.credentials import mask
from orchestrator.events.targets import EventTarget, parse_target
from orchestrator.events.zones import ZonesFile, read_zones
from orchestrator.ignored import Ignored, read_ignored
from orchestrator.log import LogFormat
from orchestrator.mistaken_flags import refuse_source_behind, unknown_flag
from orchestrator.monitor.address import MonitorAddress
from orchestrator.program import command_line_of
from orchestrator.run.argument_streams import DEMO, argument_address, default_output
from orchestrator.run.retention_limits import HOUR, Keep, parse_keep, parse_segment
from orchestrator.run.zones_history import newest_zones

__all__ = ["Arguments", "parse"]


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
    parser = command_parser()
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
        zones=_zones(given.zones, output if given.resume else None),
        events=tuple(parse_target(text) for text in given.events),
        watch=given.watch,
        segment=parse_segment(given.segment) if given.segment else HOUR if keep else None,
        keep=keep,
        give_up_after=given.give_up_after,
        places=given.places,
        log=given.log,
    )


def _zones(path: Path | None, resumed: Path | None) -> ZonesFile:
    """Read the zones; of a resumed run those of before, if the file cannot be used, so that it goes on."""
    before = None if resumed is None else newest_zones(resumed)
    if path is None:
        if before is None:
            return ZonesFile()
        words = f"The zones of before hold on ({before}); for others, give --zones."
        return replace(read_zones(before), fault=words)
    try:
        return read_zones(path)
    except ConfigError as error:
        if before is None:
            raise
        words = f"{str(error).rstrip('.')}. The zones of before hold on ({before})."
        return replace(read_zones(before), path=path.absolute(), fault=words)


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
