"""A trained network in use: classify, infer, measure, count its cost."""
