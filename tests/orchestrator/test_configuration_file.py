"""The parameters as they are written out for people."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest
import yaml
from pydantic import BaseModel, Field

from mlbs_actors.config import Config, load_config
from orchestrator.configuration_file import as_markdown, as_yaml, configuration_texts, describe

REPOSITORY = Path(__file__).resolve().parents[2]


class Lens(BaseModel):
    """What the lens does (§2).

    A second paragraph that is not for the list.
    """

    focus_px: float = Field(1e-5, gt=0, le=1, description="Width of |f|.")
    blur: float = Field(0.5, ge=0, description="Least blur, grey levels.")
    hold_frames: int = Field(3, ge=1, le=5, description="Frames held.")
    speed_px: float = Field(2.0, lt=9, description="Speed it follows, px/frame.")
    mode: Literal["near", "far"] = Field("far", description="Where it looks.")


class Camera(BaseModel):
    """All of it."""

    lens: Lens = Lens()


# The files in the repository


@pytest.mark.parametrize("name", ["configs/default.yaml", "docs/configuration.md"])
def test_the_written_files_are_in_step_with_the_models(name: str) -> None:
    written = (REPOSITORY / name).read_text(encoding="utf-8")
    assert written == configuration_texts()[name], f"{name} is out of step; run scripts/configuration"


def test_the_default_file_changes_nothing() -> None:
    assert load_config(REPOSITORY / "configs/default.yaml") == Config()


def test_the_default_file_holds_every_parameter() -> None:
    written = yaml.safe_load((REPOSITORY / "configs/default.yaml").read_text(encoding="utf-8"))
    assert written == Config().model_dump()


def test_every_section_has_a_title_and_every_parameter_a_sentence_as_its_meaning() -> None:
    for section in describe(Config):
        assert section.title.endswith("."), section.key
        assert section.parameters, section.key
        for parameter in section.parameters:
            assert parameter.meaning.endswith("."), f"{section.key}.{parameter.key}"


# How they are written


def test_meaning_unit_and_range_stand_above_each_value() -> None:
    body = as_yaml(describe(Camera)).partition("\n\n")[2]
    assert body == (
        "# What the lens does (§2).\n"
        "lens:\n"
        "  # Width of |f|. Unit: px. Allowed: > 0, ≤ 1.\n"
        "  focus_px: 1.0e-05\n"
        "  # Least blur, grey levels. Allowed: ≥ 0.\n"
        "  blur: 0.5\n"
        "  # Frames held. Allowed: ≥ 1, ≤ 5.\n"
        "  hold_frames: 3\n"
        "  # Speed it follows, px/frame. Allowed: < 9.\n"
        "  speed_px: 2.0\n"
        "  # Where it looks. Allowed: near, far.\n"
        "  mode: far\n"
    )


def test_what_is_written_reads_back_as_the_same_values() -> None:
    assert yaml.safe_load(as_yaml(describe(Camera))) == Camera().model_dump()


def test_the_page_has_a_row_a_parameter_with_bars_escaped() -> None:
    rows = [line for line in as_markdown(describe(Camera)).splitlines() if line.startswith("| `")]
    assert rows == [
        r"| `focus_px` | 1.0e-05 | px | > 0, ≤ 1 | Width of \|f\|. |",
        "| `blur` | 0.5 | grey levels | ≥ 0 | Least blur, grey levels. |",
        "| `hold_frames` | 3 | frames | ≥ 1, ≤ 5 | Frames held. |",
        "| `speed_px` | 2.0 | px/frame | < 9 | Speed it follows, px/frame. |",
        "| `mode` | far |  | near, far | Where it looks. |",
    ]
