"""Many robots in C: the engine's sources, and its Python side, ``native``."""
