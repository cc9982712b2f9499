"""Files of other programs, read in three steps: a table, what its columns are, and how its time stamps are read.

`table/`: the rows of a text and what stands above them. `columns`: taxels, times, and columns that are neither.
`clock/`: stamps, their unit, and trials at one sampling rate. `formats/`: the door of other formats.
`folder`, `one_table` and `arrays` find the trials. `doubts`: what looks wrong.
"""
