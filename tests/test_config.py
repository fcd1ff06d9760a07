"""Parameters: frozen, checked, read from a file and from the command line, and refused in a sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from mlbs_actors.config import Config, detail, length_scale, load_config
from mlbs_actors.errors import ConfigError


def written(folder: Path, text: str) -> Path:
    path = folder / "parameters.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_without_a_file_the_defaults_hold() -> None:
    assert load_config() == Config()


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    path = written(tmp_path, "layers:\n  lookahead: 4\nflow: {finest_scale: 1}\n")
    config = load_config(path)
    assert config.layers.lookahead == 4
    assert config.flow.finest_scale == 1
    assert config == Config.model_validate({"layers": {"lookahead": 4}, "flow": {"finest_scale": 1}})
    assert config.layers.max_layers == Config().layers.max_layers


@pytest.mark.parametrize("text", ["", "# only a remark\n"])
def test_an_empty_file_changes_nothing(tmp_path: Path, text: str) -> None:
    assert load_config(written(tmp_path, text)) == Config()


def test_an_override_comes_after_the_file_and_the_last_one_wins(tmp_path: Path) -> None:
    path = written(tmp_path, "layers:\n  lookahead: 4\n  max_layers: 9\n")
    config = load_config(path, ["layers.lookahead=2", "grid.cell_px = 0.25", "layers.lookahead=3"])
    assert (config.layers.lookahead, config.layers.max_layers, config.grid.cell_px) == (3, 9, 0.25)


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("layers.lookahead", "write it as in layers.lookahead=4"),
        ("lookahead=4", "write it as in layers.lookahead=4"),
        (".lookahead=4", "write it as in layers.lookahead=4"),
        ("layers.=4", "write it as in layers.lookahead=4"),
        ("=", "write it as in layers.lookahead=4"),
        ("layers.lookahead=[1", "cannot be read"),
        ("layers.lookahead=-1", "layers.lookahead: Input should be greater than or equal to 0"),
        ("layers.lookahead=soon", "layers.lookahead: Input should be a valid integer"),
        ("layers.lookahead=", "layers.lookahead: Input should be a valid integer"),
        ("layers.lookahed=1", "no parameter layers.lookahed; did you mean layers.lookahead?"),
        ("layers.colour=1", "there is no parameter layers.colour (all of them"),
        ("layer.lookahead=1", "no parameter layer; did you mean layers?"),
        ("layers.init_frames=6", "layers.init_frames: Input should be less than or equal to 5"),
        ("flow.finest_scale=4", "flow.finest_scale: Input should be less than or equal to 3"),
        ("grid.cell_px=.nan", "grid.cell_px"),
        ("segmentation.label_cost=.inf", "segmentation.label_cost"),
    ],
)
def test_a_wrong_override_is_refused_in_a_sentence(override: str, complaint: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load_config(None, [override])
    assert complaint in str(refused.value)
    assert str(refused.value).endswith(".")
    assert len(refused.value.args) == 1


def test_all_wrong_values_are_named_at_once() -> None:
    with pytest.raises(ConfigError, match=r"grid\.cell_px: .*; layers\.lookahead: "):
        load_config(None, ["layers.lookahead=-1", "grid.cell_px=-7"])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("- a\n- b\n", "must hold sections of key: value pairs"),
        ("just text", "must hold sections of key: value pairs"),
        ("layers: [", "cannot be read"),
        ("layers: 3\n", "the section 'layers' must hold key: value pairs"),
        ("layers: !!python/object/apply:os.system ['true']\n", "cannot be read"),
    ],
)
def test_a_wrong_file_is_refused_in_a_sentence(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        load_config(written(tmp_path, text))


def test_a_file_that_is_missing_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.yaml cannot be read: No such file"):
        load_config(tmp_path / "missing.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ConfigError, match="no text in UTF-8"):
        load_config(binary)


def test_an_override_of_a_section_that_is_no_section_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="must hold key: value pairs"):
        load_config(written(tmp_path, "layers: 3\n"), ["layers.lookahead=1"])


def test_parameters_cannot_be_changed_afterwards() -> None:
    config = Config()
    with pytest.raises(ValidationError):
        config.layers = config.layers  # type: ignore[misc]
    with pytest.raises(ValidationError):
        config.layers.lookahead = 3  # type: ignore[misc]


def test_a_configuration_survives_being_written_down() -> None:
    config = load_config(None, ["layers.lookahead=2", "affinity.propagation=absorbing"])
    assert Config.model_validate_json(config.model_dump_json()) == config


def test_lengths_scale_with_the_square_root_of_the_area() -> None:
    assert length_scale(480, 640) == 1.0
    assert length_scale(240, 320) == 0.5
    assert length_scale(640, 480) == 1.0
    assert length_scale(720, 720) == length_scale(540, 960)


def test_in_large_frames_lengths_grow_less_than_the_frame() -> None:
    """… so that smaller things are seen: at four times the side they are twice as long."""
    assert detail(540, 960) == 1.0
    assert length_scale(4 * 480, 4 * 640) == pytest.approx(2.04, abs=0.01)
    assert detail(4 * 480, 4 * 640) == pytest.approx(4 / 2.04, abs=0.01)
    assert length_scale(1080, 1920) == length_scale(1920, 1080)


def test_one_override_without_a_list_is_told_how_to_be_written() -> None:
    with pytest.raises(ConfigError, match=r"overrides is one string, .*; give a list: \['layers"):
        load_config(None, "layers.lookahead=3")
