"""Drawings that any study uses, for print."""
