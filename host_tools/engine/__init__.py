"""Many robots in C: the engine's sources, and its Python side in ``host_tools.engine.native``."""
