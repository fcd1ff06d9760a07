"""MOTS: a text file for each stream, a line for each frame and object."""

from __future__ import annotations

from pathlib import Path

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.recorded_stream import recorded_stream, streams_of

__all__ = ["CLASS", "write_mots"]

#: Class of all objects; the format has 1 = car and 2 = pedestrian.
CLASS = 1

_OBJECTS_OF_A_CLASS = 1000  # an object's id holds its class in the thousands


def write_mots(run: Path, out: Path) -> None:
    """Write ``STREAM.txt`` with the lines ``frame id class height width run-length-code``.

    Parameters
    ----------
    run : Path
    out : Path
        An existing folder.

    Raises
    ------
    ConfigError
        If a layer's id does not fit into the format.
    """
    for name in streams_of(run):
        with (out / f"{name}.txt").open("w", encoding="utf-8") as file:
            for frame in recorded_stream(run / name):
                for one, code in zip(frame.objects, frame.codes, strict=True):
                    if one.layer >= _OBJECTS_OF_A_CLASS:
                        raise ConfigError(
                            f"MOTS has no place for layer {one.layer} of {name!r}, only for ids up to "
                            f"{_OBJECTS_OF_A_CLASS - 1}; export to coco."
                        )
                    number = CLASS * _OBJECTS_OF_A_CLASS + one.layer
                    file.write(f"{frame.index} {number} {CLASS} {frame.height} {frame.width} {code}\n")
