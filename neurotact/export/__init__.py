"""Event files, figures and exchange formats."""
