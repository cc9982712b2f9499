"""Figures for print, for any study."""
