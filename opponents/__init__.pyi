from .elm import ELMClassifier as ELMClassifier
from .minirocket import MiniRocket as MiniRocket
from .minirocket import MiniRocketClassifier as MiniRocketClassifier
from .pooled_gru import PooledGRUClassifier as PooledGRUClassifier
