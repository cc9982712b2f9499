"""Recordings, conditioning, windows and splits."""
