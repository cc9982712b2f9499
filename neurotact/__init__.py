"""Spiking touch: taxel signals to mechanoreceptor spikes to a decision, and what each saving costs.

`import neurotact as nt` is the front door. Names are loaded when they are first used, so that the import takes
milliseconds; `__init__.pyi` lists them.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*__all__, "__version__"]
