from .afferents import AfferentSpec as AfferentSpec
from .transformer import SpikeEncoder as SpikeEncoder
