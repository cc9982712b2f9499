"""Specs of spiking networks, and the spaces of searches."""
