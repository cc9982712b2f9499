"""Reports of run folders: one HTML page each that opens anywhere, offline, its figures and its tables."""
