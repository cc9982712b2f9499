"""Hyperparameter search: proposals, the journal, what a search tells."""
