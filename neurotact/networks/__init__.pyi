from .definition.rsnn import RSNN as RSNN
from .definition.specs import RSNNSpec as RSNNSpec
from .definition.specs import TrainingSpec as TrainingSpec
from .use.classifier import SpikingClassifier as SpikingClassifier
