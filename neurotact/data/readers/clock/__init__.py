"""Clocks: how time stamps are read, and trials at one sampling rate."""
