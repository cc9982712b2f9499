"""The front door: one function for each thing that a user does, on objects in memory or on files.

Each joins rooms that know nothing of one another; estimators, specs and arrays come from their own rooms. The command
line calls these functions alone, so that both do the same with the same defaults.
"""
