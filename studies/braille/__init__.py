"""Braille reading with spiking networks (Müller-Cleve et al. 2022, doi 10.3389/fnins.2022.951164)."""
