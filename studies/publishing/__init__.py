"""What a paper needs of a study: one folder with its tables, figures, methods, references, and how to run it again."""
