"""The classical classifiers that a spiking network is set beside, in scikit-learn's API."""
