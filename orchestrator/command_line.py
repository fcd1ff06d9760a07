"""The command line: what is asked for, and how wrong options are refused."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mlbs_actors.errors import ConfigError
from orchestrator.command_options import command_parser, flag_of
from orchestrator.events.zones import ZonesFile, read_zones
from orchestrator.mistaken_flags import refuse_source_behind, unknown_flag
from orchestrator.object_storage.address import StoreAddress, scratch_place
from orchestrator.option import Form
from orchestrator.options import Arguments, options
from orchestrator.program import command_line_of
from orchestrator.run.argument_streams import DEMO, argument_address, default_output
from orchestrator.run.edited_files import newest_version
from orchestrator.run.file_watch import stamp_of
from orchestrator.run.retention_limits import segment_with

__all__ = ["command_again", "parse"]


def parse(argv: Sequence[str], begin: Callable[[Arguments], None] = lambda _: None) -> Arguments:
    """Read the command line.

    Parameters
    ----------
    argv : sequence of str
    begin : callable
        Makes the output folder what it has to be, before what an earlier run has left there is read.

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
        parser.error(unknown_flag(unknown[0], [flag_of(name) for name, _ in options()]))
    values: dict[str, Any] = {"sources": tuple(given.sources)}
    for name, option in options():
        raw = getattr(given, name)
        if option.form in (Form.WORDS, Form.OPTIONAL_VALUE):
            refuse_source_behind(flag_of(name), raw if isinstance(raw, list) else [raw])
        if raw is not None:
            values[name] = option.value(flag_of(name), raw)
    if not values["sources"] and given.streams is None:
        if not given.or_demo:
            raise ConfigError(
                f"Name a video, a folder of videos or images, or a camera: {command_line_of('street.mp4')}; "
                f"or try {command_line_of('demo')}. All else: {command_line_of('--help')}"
            )
        values["sources"] = (DEMO,)
    if given.output is None and given.streams is None:
        values["output"] = default_output(values["sources"], resume=given.resume)
    if isinstance(store := values.get("output"), StoreAddress):
        values |= {"store": store, "output": scratch_place(store, values.get("scratch")) / "run"}
    zones = values.pop("zones", None)
    arguments = Arguments(**values, zones=ZonesFile())
    _refuse_together(arguments)
    begin(arguments)
    return replace(
        arguments,
        zones=_zones(zones, arguments.output if arguments.resume else None),
        segment=segment_with(arguments.segment, arguments.keep),
    )


def command_again(arguments: Arguments, output: str) -> list[str]:
    """Return the command that starts the same run from any folder, with another output folder."""
    words = [sys.executable, "-m", "orchestrator"]
    words += [argument_address(source).location for source in arguments.sources]
    for name, option in options():
        if name == "output":
            words += [flag_of(name), output]
        value = getattr(arguments, name)
        if option.write is None or value is None or value is False:
            continue
        texts = option.write(value)
        if option.form is Form.REPEATED:
            words += [word for text in texts for word in (flag_of(name), text)]
        elif texts or option.form is Form.FLAG:
            words += [flag_of(name), *texts]
    return words


def _refuse_together(arguments: Arguments) -> None:
    """Raise ConfigError if options do not go together."""
    if arguments.watch and arguments.streams is None:
        raise ConfigError(
            "--watch reads a list again; write your sources into one and name it with --streams."
        )
    if arguments.make and "parquet" not in arguments.save:
        raise ConfigError("--make reads the tables; add parquet to --save.")
    if arguments.scratch is not None and arguments.store is None:
        raise ConfigError("--scratch is for an object store as --output; a folder needs none. Leave it out.")
    if arguments.private and "cutouts" in arguments.save:
        raise ConfigError("--save cutouts cuts out what --private hides; leave one of them out.")
    if arguments.private and arguments.clips is not None:
        raise ConfigError("--clips keeps the cameras' own video, which --private cannot blur; leave one out.")
    if arguments.ray_metrics and arguments.address is not None:
        raise ConfigError(
            "With --address metrics come from ports of the cluster; give --ray-metrics without PORT."
        )
    if arguments.ray_metrics == 0 and arguments.address is None:
        raise ConfigError(
            "--ray-metrics takes a PORT of this machine, from 1 to 65535, such as --ray-metrics 9465."
        )


def _zones(path: Path | None, resumed: Path | None) -> ZonesFile:
    """Read the zones; of a resumed run those of before, if the file cannot be used, so that it goes on."""
    before = None if resumed is None else newest_version(resumed, "zones")
    if path is None:
        if before is None:
            return ZonesFile()
        words = f"The zones of before hold on ({before}); for others, give --zones."
        return replace(read_zones(before), fault=words)
    stamp = stamp_of(path)
    try:
        return replace(read_zones(path), stamp=stamp)
    except ConfigError as error:
        if before is None:
            raise
        words = f"{str(error).rstrip('.')}. The zones of before hold on ({before})."
        return replace(read_zones(before), path=path.absolute(), fault=words, stamp=stamp)
