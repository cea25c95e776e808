"""A run as a page in a browser, from a recording or live.

``__init__.pyi`` names what other rooms may use; it is loaded when first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
