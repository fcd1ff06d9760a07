"""The options of a run that a file of cameras can also give for each stream by itself.

The fields of :class:`orchestrator.options.Arguments` say of what type their values are, and the defaults.
"""

from orchestrator import option_values as values
from orchestrator.option import Effect, Form, Option

__all__ = ["DRAW", "GIVE_UP_AFTER", "IGNORE", "KEEP", "MAX_SIDE", "SAVE", "SEGMENT", "SET", "TIME_ZONE"]

SET = Option(
    "parameters, after those of --config; for example layers.lookahead=4",
    "SECTION.KEY=VALUE",
    form=Form.WORDS,
    read=tuple,
    write=list,
    effect=Effect.EPOCH,
    of_streams=True,
    page="configuration.md",
)

SAVE = Option(
    f"which of {', '.join(values.SAVABLE)} to write, with commas (default: the first three)",
    "PARTS",
    read=values.parts,
    write=lambda save: [",".join(part for part in values.SAVABLE if part in save)],
    record=sorted,
    effect=Effect.RESTART,
    of_streams=True,
    page="outputs.md",
)

DRAW = Option(
    f"what overlays and other pictures show beside the objects: any of {', '.join(values.DRAWABLE)}, "
    'with commas, or "" for nothing (default: the first three)',
    "WHAT",
    read=values.drawn,
    write=lambda drawn: [",".join(what for what in values.DRAWABLE if what in drawn)],
    effect=Effect.RESTART,
    of_streams=True,
    page="outputs.md#what-pictures-show",
)

TIME_ZONE = Option(
    "time zone of the times in pictures, such as Europe/Berlin (default: that of this machine)",
    "NAME",
    read=values.time_zone,
    write=values.one_word,
    effect=Effect.RESTART,
    of_streams=True,
    page="outputs.md#what-pictures-show",
)

MAX_SIDE = Option(
    "process pictures shrunk to N px on the longer side; all results have full size, with "
    "outlines as coarse as the smaller picture (default: process them as they are)",
    "N",
    read=values.side,
    write=values.one_word,
    record=values.as_given,
    effect=Effect.EPOCH,
    of_streams=True,
    page="scaling.md",
)

IGNORE = Option(
    "what is fixed in the picture of the stream NAME (default: of all), besides what is found"
    " by itself: a picture in which it is not 0, or a text file with a polygon on each line, "
    "x1,y1,x2,y2,… from 0 to 1 of the picture's width and height; may be given again for "
    "other streams",
    "[NAME=]FILE",
    form=Form.REPEATED,
    read=values.ignored,
    write=lambda ignored: list(ignored.digests),
    record=lambda ignored: ignored.digests or None,
    effect=Effect.RESTART,
    of_streams=True,
    page="method.md#what-is-fixed-in-the-picture",
)

SEGMENT = Option(
    "write the record of each camera in segments of an hour, a day, or a number of seconds: a "
    "folder DIR/NAME/TIME for each, with one archive of all masks (default: none; with --keep"
    " hour)",
    "TIME",
    read=values.segment,
    write=values.one_word,
    record=values.as_given,
    effect=Effect.RESTART,
    of_streams=True,
    page="outputs.md#cameras-in-segments",
)

KEEP = Option(
    "of cameras delete the oldest closed segments, so that what is left is not older than an "
    "age, such as 7d, or all together not larger than a size, such as 50GB; may be given "
    "twice, once for each",
    "LIMIT",
    form=Form.REPEATED,
    read=values.keep,
    write=lambda keep: list(keep.words),
    record=lambda keep: list(keep.words),
    effect=Effect.AT_ONCE,
    of_streams=True,
    page="outputs.md#what-is-kept",
)

GIVE_UP_AFTER = Option(
    "end the stream of a camera that sent no picture for this long, also at the start "
    "(default: try it again for ever)",
    "SECONDS",
    read=values.at_least_one,
    write=values.one_word,
    effect=Effect.RESTART,
    of_streams=True,
    page="command_line.md#cameras",
)
