"""What an object's compiled frame is told of the configuration: numbers, and functions of one as tables."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.appearance.colour_density import AppearanceParameters, confidence, density_tables
from mlbs_actors.appearance.fusion import LIKELIHOOD, appearance_tables
from mlbs_actors.config import Config, length_scale
from mlbs_actors.layer.posterior_terms import cost_tables, uncontested_cost
from mlbs_actors.messages import COST_STEP, UNEXPLAINED_STEP, Array

__all__ = ["ObjectParameters", "ObjectTables", "object_parameters", "object_tables"]


class ObjectParameters(NamedTuple):
    """Numbers that an object is evaluated with, those of the configuration where nothing else is said.

    Attributes
    ----------
    bandwidth_floor, registration : float
        Of :class:`~mlbs_actors.appearance.colour_density.AppearanceParameters`.
    appearance_cap, photometric_cap : float
    unexplained : float
        From where on the camera fails to explain a cell, in units of ``UNEXPLAINED_STEP``.
    close, learn, near, fade : float
        px of this frame.
    distance, photometric : float
    flow_variance : float
        px².
    neutral_prior, offset : float
    uncontested : float
        :func:`~mlbs_actors.layer.posterior_terms.uncontested_cost`.
    appearance : float
        Weight of the colours, units of ``COST_STEP``.
    margin, covered_margin : float
        px of a 640×480 frame.
    scale : float
        :func:`~mlbs_actors.config.length_scale`.
    """

    bandwidth_floor: float
    registration: float
    appearance_cap: float
    photometric_cap: float
    unexplained: float
    close: float
    learn: float
    near: float
    fade: float
    distance: float
    photometric: float
    flow_variance: float
    neutral_prior: float
    offset: float
    uncontested: float
    appearance: float
    margin: float
    covered_margin: float
    scale: float


class ObjectTables(NamedTuple):
    """Functions of one number that an object is evaluated with, all (n,) float32.

    Attributes
    ----------
    exponent, norm : Array
        :func:`~mlbs_actors.appearance.colour_density.density_tables`.
    heard, disagreement, surprise : Array
        :func:`~mlbs_actors.layer.posterior_terms.cost_tables`.
    trust : Array
        By numbers of samples, :func:`~mlbs_actors.appearance.colour_density.confidence`.
    known, ratio_of : Array
        :func:`~mlbs_actors.appearance.fusion.appearance_tables`.
    likelihood : Array
        :data:`~mlbs_actors.appearance.fusion.LIKELIHOOD`.
    """

    exponent: Array
    norm: Array
    heard: Array
    disagreement: Array
    surprise: Array
    trust: Array
    known: Array
    ratio_of: Array
    likelihood: Array


def object_parameters(
    config: Config, density: AppearanceParameters, shape: tuple[int, int]
) -> ObjectParameters:
    """Those of a configuration, for frames of a size (H, W)."""
    weights, scale = config.posterior, length_scale(*shape)
    return ObjectParameters(
        bandwidth_floor=density.bandwidth_floor,
        registration=density.registration,
        appearance_cap=weights.appearance_cap,
        photometric_cap=weights.photometric_cap,
        unexplained=config.layers.unexplained_noise / UNEXPLAINED_STEP,
        close=weights.close_px * scale,
        learn=weights.learn_px * scale,
        near=weights.near_px * scale,
        fade=weights.fade_px * scale,
        distance=weights.distance,
        photometric=weights.photometric,
        flow_variance=(config.motion.flow_std_px * scale) ** 2,
        neutral_prior=weights.neutral_prior,
        offset=weights.offset,
        uncontested=uncontested_cost(config),
        appearance=weights.appearance / COST_STEP,
        margin=weights.region_margin_px,
        covered_margin=weights.covered_margin_px,
        scale=scale,
    )


def object_tables(config: Config, density: AppearanceParameters) -> ObjectTables:
    """Those of a configuration."""
    known, ratio_of = appearance_tables(config.appearance.half_confidence_samples)
    return ObjectTables(
        *density_tables(density),
        *cost_tables(config, "object"),
        trust=confidence(np.arange(256), density),
        known=known,
        ratio_of=ratio_of,
        likelihood=LIKELIHOOD,
    )
