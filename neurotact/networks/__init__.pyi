from .classifier import SpikingClassifier as SpikingClassifier
from .rsnn import RSNN as RSNN
from .snntorch_exchange import from_snntorch as from_snntorch
from .snntorch_exchange import to_snntorch as to_snntorch
from .specs import RSNNSpec as RSNNSpec
from .specs import TrainingSpec as TrainingSpec
