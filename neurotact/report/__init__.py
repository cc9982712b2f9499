"""The page that a run folder becomes: it reads tables and computes nothing."""
