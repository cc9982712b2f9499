"""Hyperparameter search: proposals, the journal, what a search tells; found by name, as the tools of others."""
