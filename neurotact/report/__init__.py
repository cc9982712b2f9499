"""The report page of a run folder: it reads tables and computes nothing."""
