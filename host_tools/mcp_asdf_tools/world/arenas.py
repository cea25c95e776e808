"""The moving world of an experiment: docs/arena.md, with the experiment's sides, floor and seed."""

from __future__ import annotations

from mcp_asdf_tools.experiments.experiment import Experiment, Floor
from mcp_asdf_tools.world import floor_images
from mcp_asdf_tools.world.arena import Arena, ArenaSettings, Picture, Tiles
from mcp_asdf_tools.world.philox import world_seed


def arena_settings(experiment: Experiment) -> ArenaSettings:
    """The arena of a dynamic experiment. Raises UsageError if its picture cannot be read or has changed."""
    width, height = experiment.sides
    return ArenaSettings(
        experiment.robots,
        width,
        height,
        floor=_floor(experiment),
        speed=experiment.speed,
        radio_range=experiment.radio_range,
        ticks_per_second=experiment.ticks_per_second,
    )


def make_arena(experiment: Experiment, trial: int) -> Arena:
    """The arena of one trial, at tick 0. Raises UsageError if it cannot be."""
    return Arena(arena_settings(experiment), world_seed(experiment.seed, trial))


def _floor(experiment: Experiment) -> Tiles | Picture:
    if experiment.floor is Floor.CODE:
        return Picture(floor_images.code(experiment.fill_ratio))
    if experiment.floor is Floor.PICTURE:
        return Picture(floor_images.picture_of(experiment.picture, experiment.picture_sha256))
    return Tiles(experiment.fill_ratio, experiment.tile)
