"""The figures that the paper's evaluation (§8) publishes, and the sequences that they are of.

They are those of Zhu and Elgammal (ICCV 2017) for the ten sequences of the Berkeley Motion Segmentation data
set.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mlbs_actors.errors import ConfigError

__all__ = [
    "METHODS",
    "MULTI_LABEL",
    "SEQUENCES",
    "STAGES",
    "TIMED_SEQUENCE",
    "PaperSequence",
    "PaperStage",
    "PublishedMultiLabel",
    "base_name",
    "missing_sequences",
    "paper_sequences",
]

#: The methods of the paper's table 1; the first is the paper's own.
METHODS = ("MLBS", "GBSSP", "FOF", "OMCBS", "GBS", "BSFMC")


@dataclass(frozen=True, slots=True)
class PaperSequence:
    """A sequence of the paper and its published figures.

    Attributes
    ----------
    name : str
        Also the name of its folder.
    moving_objects : str
        How many objects move in it at a time.
    two_label_f : tuple of float
        Percent, by :data:`METHODS`.
    """

    name: str
    moving_objects: str
    two_label_f: tuple[float, ...]


SEQUENCES: tuple[PaperSequence, ...] = (
    PaperSequence("cars1", "1", (92.04, 87.14, 50.84, 91.77, 80.30, 73.13)),
    PaperSequence("cars2", "2–3", (90.16, 82.17, 56.60, 69.13, 68.45, 55.68)),
    PaperSequence("cars3", "2", (93.16, 72.94, 73.57, 41.27, 79.22, 60.91)),
    PaperSequence("cars4", "1", (91.55, 88.24, 47.96, 73.65, 66.63, 54.81)),
    PaperSequence("cars5", "3", (86.62, 81.66, 70.94, 60.44, 74.56, 51.97)),
    PaperSequence("cars6", "1", (92.23, 81.44, 84.34, 90.31, 73.34, 37.56)),
    PaperSequence("cars7", "1", (91.17, 90.86, 42.92, 89.87, 69.10, 40.35)),
    PaperSequence("cars8", "1–2", (85.93, 86.85, 87.61, 83.84, 80.29, 62.42)),
    PaperSequence("people1", "1", (81.38, 81.21, 69.59, 64.04, 80.19, 34.25)),
    PaperSequence("people2", "1–2", (94.34, 84.74, 88.40, 89.32, 81.40, 64.92)),
)


@dataclass(frozen=True, slots=True)
class PublishedMultiLabel:
    """A published line of the multi-label figures, means over all ten sequences.

    Attributes
    ----------
    method : str
    frames : str
        Which frames of each sequence, ``first ten frames`` or ``all frames``.
    precision, recall, f : float
        Percent; NaN where it is not known.
    """

    method: str
    frames: str
    precision: float
    recall: float
    f: float


MULTI_LABEL: tuple[PublishedMultiLabel, ...] = (
    PublishedMultiLabel("MLBS", "first ten frames", math.nan, math.nan, 85.06),
    PublishedMultiLabel("MLBS", "all frames", 88.60, 85.05, 86.16),
    PublishedMultiLabel("SLT (offline)", "all frames", 89.51, 78.24, 82.00),
)


@dataclass(frozen=True, slots=True)
class PaperStage:
    """A stage of the paper's program and the corresponding ones of this program.

    Attributes
    ----------
    name : str
    published_ms : float
        Time a frame of cars1, ms.
    stages : tuple of str
        Keys of :attr:`~mlbs_actors.messages.Segmentation.stage_ms`.
    remark : str
        Other work of these stages.
    """

    name: str
    published_ms: float
    stages: tuple[str, ...]
    remark: str = ""


STAGES: tuple[PaperStage, ...] = (
    PaperStage("clustering", 1109, ("tracking", "affinity", "clustering"), "with the camera's motion"),
    PaperStage("motion estimation", 3675, ("gabp",)),
    PaperStage("model propagation", 144, ("posterior",), "warp, colour density and posterior in one"),
    PaperStage("graph cut", 1369, ("fusion", "cut", "cleaning"), "with shadows, specks and holes"),
    PaperStage("model update", 559, ("update",)),
)

#: The sequence on which the paper's times were taken.
TIMED_SEQUENCE = "cars1"


def paper_sequences(names: Sequence[str]) -> list[str]:
    """Select the paper's sequences among some, in the paper's order.

    Parameters
    ----------
    names : sequence of str
        Names of sequences; the last part of a path counts.

    Raises
    ------
    ConfigError
        If there is none, or two have the same name.
    """
    found = {one.name: [name for name in names if base_name(name) == one.name] for one in SEQUENCES}
    if not any(found.values()):
        known = ", ".join(one.name for one in SEQUENCES)
        raise ConfigError(
            f"None of the paper's sequences is there: {known}. Each is a folder of that name with frames/ "
            "and gt/."
        )
    for same in found.values():
        if len(same) > 1:
            raise ConfigError(
                f"{' and '.join(same)} bear the same name; choose the paper's with --sequences."
            )
    return [name for same in found.values() for name in same]


def missing_sequences(names: Sequence[str]) -> list[str]:
    """Name the paper's sequences that are not among some, in the paper's order."""
    there = {base_name(name) for name in names}
    return [one.name for one in SEQUENCES if one.name not in there]


def base_name(name: str) -> str:
    """Return the last part of a path."""
    return name.rstrip("/").rpartition("/")[2]
