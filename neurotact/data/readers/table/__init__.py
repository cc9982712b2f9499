"""A table: the rows of a text file, what stands above them, and what separates their cells."""
