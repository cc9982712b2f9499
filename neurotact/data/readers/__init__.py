"""One file for each published data set, and one for plain folders."""
