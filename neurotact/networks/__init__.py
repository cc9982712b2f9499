"""Recurrent spiking networks: definition, training, early exit, exchange."""
