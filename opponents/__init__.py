"""The classical and modern classifiers that a network is compared with, in scikit-learn's API; found by name."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
