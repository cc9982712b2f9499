"""Studies: a folder for each paper, with its specs, simulator, features, protocol and published numbers.

The framework imports none of it: `neurotact.plugins` finds the parts by name, as it finds those of other packages.
"""
