from .recordings import Recordings as Recordings
from .spikes import SpikeTrains as SpikeTrains
from .windowed import SpikeArray as SpikeArray
from .windowed import WindowedSpikes as WindowedSpikes
from .windowed import windows as windows
