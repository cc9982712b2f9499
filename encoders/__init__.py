"""Specs of encoders, and the code of those that the framework does not need."""
