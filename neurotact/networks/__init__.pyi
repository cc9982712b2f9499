from .definition.rsnn import RSNN as RSNN
from .definition.snntorch_exchange import from_snntorch as from_snntorch
from .definition.specs import RSNNSpec as RSNNSpec
from .definition.specs import TrainingSpec as TrainingSpec
from .use.classifier import SpikingClassifier as SpikingClassifier
