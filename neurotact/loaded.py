"""Loads every module whose loading was put off: the server of processes imports it last, so that none loads its own."""

from neurotact.lazily import load_all

load_all()
