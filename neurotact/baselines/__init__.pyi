from .centroid_kmeans import ClassCentroidKMeans as ClassCentroidKMeans
from .cnn_features import CNNFeatures as CNNFeatures
from .conv_lstm import ConvLSTMClassifier as ConvLSTMClassifier
from .elm import ELMClassifier as ELMClassifier
from .recurrent import GRUClassifier as GRUClassifier
from .recurrent import LSTMClassifier as LSTMClassifier
from .rls import RLSClassifier as RLSClassifier
from .slfn import SLFNClassifier as SLFNClassifier
