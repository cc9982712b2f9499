"""Specs of spiking networks, a network of several layers, and the search of hyperparameters with its spaces."""
