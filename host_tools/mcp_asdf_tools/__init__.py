"""Tools around the firmware ``mcp_asdf``: experiments, swarms on a CAN bus, scores and plots.

``__init__.pyi`` names what the library offers; it is loaded when first used.
docs/library.md has an example of each.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
