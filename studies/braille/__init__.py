"""Braille reading with spiking networks (Müller-Cleve et al. 2022, Frontiers in Neuroscience 16:951164)."""
