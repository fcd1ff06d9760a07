"""All parameters together, read from a file and from ``section.key=value`` overrides."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from mlbs_actors.config.clustering import AffinityConfig, IdentityConfig, LayersConfig
from mlbs_actors.config.layer import AppearanceConfig, MotionConfig, PosteriorConfig
from mlbs_actors.config.parameters import Parameters
from mlbs_actors.config.segmentation import SegmentationConfig
from mlbs_actors.config.tracking import FlowConfig, GridConfig, TrajectoriesConfig
from mlbs_actors.errors import ConfigError

__all__ = ["Config", "load_config", "with_overrides"]


class Config(Parameters):
    """All parameters of one stream."""

    grid: GridConfig = GridConfig()
    flow: FlowConfig = FlowConfig()
    trajectories: TrajectoriesConfig = TrajectoriesConfig()
    affinity: AffinityConfig = AffinityConfig()
    layers: LayersConfig = LayersConfig()
    identity: IdentityConfig = IdentityConfig()
    motion: MotionConfig = MotionConfig()
    appearance: AppearanceConfig = AppearanceConfig()
    posterior: PosteriorConfig = PosteriorConfig()
    segmentation: SegmentationConfig = SegmentationConfig()


def load_config(path: str | Path | None = None, overrides: Sequence[str] = ()) -> Config:
    """Read parameters from a YAML file and ``section.key=value`` overrides.

    Parameters
    ----------
    path : path or None
        YAML file with any subset of the parameters; None for the defaults.
    overrides : sequence of str
        For example ``["layers.lookahead=4"]``; applied after the file.

    Returns
    -------
    Config

    Raises
    ------
    ConfigError
        If the file cannot be read, or a key or value is wrong.
    """
    if isinstance(overrides, str):
        raise ConfigError(f"overrides is one string, {overrides!r}; give a list: [{overrides!r}].")
    values: dict[str, Any] = {}
    if path is not None:
        try:
            loaded = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"The configuration {path} cannot be read: {error.strerror}.") from None
        except UnicodeDecodeError:
            raise ConfigError(f"The configuration {path} cannot be read: it is no text in UTF-8.") from None
        except yaml.YAMLError as error:
            raise ConfigError(f"The configuration {path} cannot be read: {error}.") from error
        if loaded is not None and not isinstance(loaded, dict):
            raise ConfigError(f"The configuration {path} must hold sections of key: value pairs.")
        values = loaded or {}
    return _changed(values, overrides)


def with_overrides(config: Config, overrides: Sequence[str]) -> Config:
    """Return other parameters: those of ``config`` but for overrides, as of :func:`load_config`."""
    return _changed(config.model_dump(), overrides)


def _changed(values: dict[str, Any], overrides: Sequence[str]) -> Config:
    for override in overrides:
        name, equals, text = override.partition("=")
        section, dot, key = name.strip().partition(".")
        if not (equals and dot and section and key):
            raise ConfigError(f"{override!r} sets no parameter; write it as in layers.lookahead=4.")
        group = values.get(section) or {}
        if not isinstance(group, dict):
            raise ConfigError(f"The section {section!r} must hold key: value pairs.")
        try:
            values = {**values, section: {**group, key: yaml.safe_load(text)}}
        except yaml.YAMLError as error:
            raise ConfigError(f"The value in {override!r} cannot be read: {error}.") from error
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        problems = "; ".join(
            _problem(problem["type"], problem["loc"], problem["msg"]) for problem in error.errors()
        )
        raise ConfigError(f"The configuration cannot be used: {problems}.") from error


def _problem(kind: str, place: tuple[int | str, ...], message: str) -> str:
    name = ".".join(str(part) for part in place)
    if kind == "model_type":
        return f"the section {name!r} must hold key: value pairs"
    if kind != "extra_forbidden":
        return f"{name}: {message}"
    section = Config.model_fields.get(str(place[0])) if len(place) > 1 else None
    fields = type(section.default).model_fields if section else Config.model_fields
    near = get_close_matches(str(place[-1]), [str(field) for field in fields], 1)
    meant = f"; did you mean {'.'.join([*(str(part) for part in place[:-1]), near[0]])}?" if near else ""
    return f"there is no parameter {name}{meant} (all of them: configs/default.yaml)"
