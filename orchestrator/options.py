"""The options of a run, each written once.

A field of :class:`Arguments` says all there is to say of an option; of those that a file of cameras can give,
too, in :mod:`.stream_options`. The parser and its help, the keys of a file of cameras, the command that goes
on, what ``run.json`` holds, the check at ``--resume`` and a page of the docs come from there. Nothing has to
be installed for it but Python.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from orchestrator import option_values as values
from orchestrator import stream_options as of_streams
from orchestrator.credentials import PASSWORD_VARIABLE
from orchestrator.log import FORMATS, LogFormat
from orchestrator.make.kinds import KINDS
from orchestrator.monitor.address import TOKEN_VARIABLE, MonitorAddress
from orchestrator.option import Effect, Form, Option

if TYPE_CHECKING:
    from orchestrator.clips.settings import ClipSettings
    from orchestrator.events.targets import EventTarget
    from orchestrator.events.zones import ZonesFile
    from orchestrator.ignored import Ignored
    from orchestrator.object_storage.address import StoreAddress
    from orchestrator.run.need import Reserve
    from orchestrator.run.retention_limits import Keep

__all__ = ["DEFAULT_OUTPUT", "Arguments", "options", "recorded"]

#: Where the results of a list go.
DEFAULT_OUTPUT = Path("out")


@dataclass(frozen=True, slots=True, kw_only=True)
class Arguments:
    """The options of the command, in the order of its help."""

    #: Videos and other sources, named as arguments.
    sources: tuple[str, ...] = ()

    #: Where the results are published that are in the folder ``output``, if they are.
    store: "StoreAddress | None" = None

    streams: Annotated[
        Path | None,
        Option(
            "a list of streams, or a YAML file of cameras; they come before those of SOURCE",
            "LIST",
            read=Path,
            write=values.absolute,
            page="command_line.md#the-list",
        ),
    ] = None
    output: Annotated[
        Path,
        Option(
            "folder for the results, or s3://BUCKET/PREFIX (gs, az, abfs) to publish them in an object "
            "store; one that holds a run is refused without --resume (default: out; "
            "without a list, NAME-objects beside a single file or folder; and if that is there, out-2"
            " and so on, with --resume the last one)",
            "DIR",
            read=values.output,
            effect=Effect.FIXED,
            page="command_line.md#where-the-results-go",
        ),
    ] = DEFAULT_OUTPUT
    scratch: Annotated[
        Path | None,
        Option(
            "with an object store as --output, where the run's folder is made that is published from there "
            "(default: ~/.local/state/mlbs-actors)",
            "DIR",
            read=Path,
            write=values.absolute,
            page="object_storage.md",
        ),
    ] = None
    config: Annotated[
        Path | None,
        Option(
            "YAML file with parameters",
            "FILE",
            read=Path,
            write=values.absolute,
            effect=Effect.NEXT_START,
            page="configuration.md",
        ),
    ] = None
    set: Annotated[tuple[str, ...], of_streams.SET] = ()
    address: Annotated[
        str | None,
        Option(
            "join the Ray cluster at HOST:PORT, or auto (default: one of this run's own, on this machine)",
            "ADDR",
            read=values.cluster_address,
            write=values.one_word,
            page="cluster.md",
        ),
    ] = None
    resume: Annotated[
        bool,
        Option(
            "continue the run in DIR that was killed or interrupted, or start one if there is none; "
            "cameras continue after a row gap, and files only with the same options as before",
            form=Form.FLAG,
            page="recovery.md",
        ),
    ] = False
    save: Annotated[frozenset[str], of_streams.SAVE] = frozenset(values.SAVED)
    draw: Annotated[frozenset[str], of_streams.DRAW] = frozenset(values.DRAWN)
    make: Annotated[
        tuple[str, ...],
        Option(
            f"when the run has ended, make of each file any of {', '.join(KINDS)}, with commas, in "
            "DIR/NAME/made",
            "KIND[,KIND]",
            read=values.made,
            write=lambda kinds: [",".join(kinds)] if kinds else [],
            page="make.md",
        ),
    ] = ()
    time_zone: Annotated[str | None, of_streams.TIME_ZONE] = None
    private: Annotated[
        bool,
        Option(
            "blur what moves in every picture and video that is kept or shown, also just before it is found",
            form=Form.FLAG,
            write=values.no_words,
            record=lambda private: private or None,
            effect=Effect.FIXED,
            page="outputs.md#what-moves-made-unrecognisable",
        ),
    ] = False
    monitor: Annotated[
        MonitorAddress | None,
        Option(
            "serve a live page on this machine, and figures for Prometheus at /metrics there; at "
            f"another HOST viewers need the token in the environment variable {TOKEN_VARIABLE} "
            "(default PORT: any that is free)",
            "[HOST:]PORT",
            form=Form.OPTIONAL_VALUE,
            read=values.monitor_address,
            page="outputs.md#the-run",
        ),
    ] = None
    ray_metrics: Annotated[
        int | None,
        Option(
            "export the figures of every stream through Ray to Prometheus, at PORT of this machine; "
            "with --address, without PORT, with those of the cluster; needs pip install "
            "'mlbs-actors[ray-metrics]'",
            "PORT",
            form=Form.OPTIONAL_VALUE,
            read=values.metrics_port,
            page="outputs.md#the-run",
        ),
    ] = None
    max_frames: Annotated[
        int | None,
        Option(
            "stop each stream after N label maps; frames without one, such as those that cannot be "
            "decoded, do not count",
            "N",
            read=values.at_least_one,
            write=values.one_word,
            record=values.as_given,
        ),
    ] = None
    max_side: Annotated[int | None, of_streams.MAX_SIDE] = None
    ignore: Annotated["Ignored", of_streams.IGNORE]
    flow: Annotated[
        Path | None,
        Option(
            "use stored flow in place of the engine's own: forward/NAME/STEM.flo for the stream NAME, from "
            "the frame STEM to the next, backward/NAME/STEM.flo to the one before, or .npy",
            "FOLDER",
            read=values.existing_folder,
            write=values.absolute,
            record=str,
            effect=Effect.FIXED,
            page="research.md#another-flow",
        ),
    ] = None
    tracks: Annotated[
        Path | None,
        Option(
            "have trajectories follow stored points in place of the flow: NAME.npz for the stream NAME, with "
            "tracks (frames, points, 2) and visible (frames, points)",
            "FOLDER",
            read=values.existing_folder,
            write=values.absolute,
            record=str,
            effect=Effect.FIXED,
            page="research.md#other-trajectories",
        ),
    ] = None
    zones: Annotated[
        "ZonesFile",
        Option(
            "YAML file with zones and lines of each stream, and the least size, age and speed of "
            "objects, for the events in DIR/NAME/events.jsonl",
            "FILE",
            read=Path,
            write=lambda zones: [] if zones.path is None else [str(zones.path)],
            record=lambda zones: zones.digest,
            effect=Effect.AT_ONCE,
            page="events.md#zones",
        ),
    ]
    events: Annotated[
        tuple["EventTarget", ...],
        Option(
            "send events to mqtt://[USER[:PASSWORD]@]HOST[:PORT]/TOPIC (mqtts: by TLS), or as a POST "
            "to a webhook at http:// or https://; for a USER without PASSWORD that of the environment"
            f" variable {PASSWORD_VARIABLE} is taken; may be given again",
            "URL",
            form=Form.REPEATED,
            read=values.targets,
            write=lambda targets: [target.shown for target in targets],
            page="events.md#sending-them",
        ),
    ] = ()
    clips: Annotated[
        "ClipSettings | None",
        Option(
            "make a clip of each event of kind entered, crossed or rule, from BEFORE seconds before it to "
            "AFTER seconds after it (default: 5,5)",
            "BEFORE,AFTER",
            form=Form.OPTIONAL_VALUE,
            read=values.clips,
            write=lambda clips: [f"{clips.before:g},{clips.after:g}"],
            page="events.md#clips",
        ),
    ] = None
    page: Annotated[
        str | None,
        Option(
            "address at which others find the page of --monitor, for the links in events (default: that of "
            "--monitor, if it names a PORT and no HOST that stands for all)",
            "URL",
            read=values.page,
            page="events.md#sending-them",
        ),
    ] = None
    segment: Annotated[int | None, of_streams.SEGMENT] = None
    keep: Annotated["Keep | None", of_streams.KEEP] = None
    watch: Annotated[
        bool,
        Option(
            "read the list again whenever it changes: new names start, removed ones are finished, bad"
            " lines are reported and ignored until they are corrected; the run continues until a "
            "signal; with --resume the list may also change between two runs",
            form=Form.FLAG,
            write=values.no_words,
            page="command_line.md#a-list-that-changes",
        ),
    ] = False
    give_up_after: Annotated[int | None, of_streams.GIVE_UP_AFTER] = None
    places: Annotated[
        int | None,
        Option(
            "run N streams at once, whatever they take (default: two files a core, and cameras as "
            "long as CPU time and memory last for what they are measured to take)",
            "N",
            read=values.at_least_one,
            write=values.one_word,
            page="scaling.md#more-streams",
        ),
    ] = None
    reserve: Annotated[
        "Reserve | None",
        Option(
            "what each stream takes of a node; as many run at once as fit, and with --address it is "
            "reserved; one of the two is enough (default: half a CPU, and memory by the size of the "
            "pictures, 1.2 GB where that is not known)",
            "cpu=N,memory=SIZE",
            read=values.reserve,
            write=lambda reserve: [reserve.words],
            page="cluster.md#what-streams-ask-of-ray",
        ),
    ] = None
    log: Annotated[
        LogFormat,
        Option(
            f"how progress and messages are written, {' or '.join(FORMATS)}: json for JSON lines "
            "(default: text, a live table on a terminal, else a line of text per stream when "
            "something changes, and now and then)",
            "FORMAT",
            read=values.log_format,
            page="command_line.md#what-is-printed",
        ),
    ] = "text"

    @property
    def results(self) -> str:
        """Where the user finds the results."""
        return str(self.store or self.output.resolve())


def options() -> Iterator[tuple[str, Option]]:
    """Yield the name of each option, as a field of :class:`Arguments`, with what is to say of it."""
    for name, annotation in Arguments.__annotations__.items():
        for one in get_args(annotation):
            if isinstance(one, Option):
                yield name, one


def recorded(values: Mapping[str, Any]) -> dict[str, object]:
    """Return what ``run.json`` holds of options, by their names; of those that are missing None."""
    kept = {name: option.record for name, option in options() if option.record is not None}
    given = {name: values.get(name) for name in kept}
    return {name: None if given[name] is None else record(given[name]) for name, record in kept.items()}
