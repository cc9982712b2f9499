"""Formats of files, one in a module."""
