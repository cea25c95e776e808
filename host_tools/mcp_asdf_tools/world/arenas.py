"""Arenas from world settings: docs/arena.md, with their sides, floor and seed."""

from __future__ import annotations

from mcp_asdf_tools.world import floor_images
from mcp_asdf_tools.world.arena import Arena, ArenaSettings, Picture, Tiles
from mcp_asdf_tools.world.philox import world_seed
from mcp_asdf_tools.world.settings import Floor, WorldSettings


def arena_settings(settings: WorldSettings) -> ArenaSettings:
    """The arena of robots that move. Raises UsageError if its picture cannot be read or has changed."""
    width, height = settings.sides
    return ArenaSettings(
        settings.robots,
        width,
        height,
        floor=_floor(settings),
        speed=settings.speed,
        radio_range=settings.radio_range,
        steps_per_second=settings.steps_per_second,
    )


def make_arena(settings: WorldSettings, trial: int) -> Arena:
    """The arena of one trial, at tick 0. Raises UsageError if it cannot be."""
    return Arena(arena_settings(settings), world_seed(settings.seed, trial))


def _floor(settings: WorldSettings) -> Tiles | Picture:
    if settings.floor is Floor.CODE:
        return Picture(floor_images.code(settings.fill_ratio))
    if settings.floor is Floor.PICTURE:
        return Picture(floor_images.picture_of(settings.picture, settings.picture_sha256))
    return Tiles(settings.fill_ratio, settings.tile)
